"""Write the results of the benchmark into the README: ``python -m benchmarks.readme_table [--history FILE]``, in a checkout.

The numbers come from the ``history.json`` that ``graspforce bench --site FOLDER`` writes beside its page, and
``python -m benchmarks.suite pages`` beside its report.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from graspforce.bench.readme_table import readme_table, replace_table
from graspforce.core.whole_file import write_text

ROOT = Path(__file__).parents[1]
HISTORY = ROOT / "benchmarks" / "results" / "suite" / "history.json"


def main() -> None:
    """Replace the table in the README."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.readme_table", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--history", type=Path, default=HISTORY, help="history.json of a page (default: of the whole suite)")
    parser.add_argument("--readme", type=Path, default=ROOT / "README.md", help="the README (default: of the checkout)")
    options = parser.parse_args()
    table = readme_table(json.loads(options.history.read_text(encoding="utf-8")))
    write_text(options.readme, replace_table(options.readme.read_text(encoding="utf-8"), table))
    print(table)


if __name__ == "__main__":
    main()
