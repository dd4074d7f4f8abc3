"""Print the comment of a pull request on the smoke set: ``python -m benchmarks.smoke_comment FOLDER/history.json``.

The file is the one beside the page of ``graspforce bench --smoke --site FOLDER``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from graspforce.bench.readme_table import readme_table


def smoke_comment(history: Sequence[Mapping[str, Any]]) -> str:
    """Return the comment: the table, and what its columns mean.

    Args:
        history: entries of ``history.json``.
    """
    last = history[-1]
    words = (
        f"Default settings, scaled; graspforce {last['graspforce']}, problem data {last['data']}. *Correct*: correct answers "
        "of the cases that the solver attempted. *Time*: shifted geometric mean over the cases that all solvers support, over "
        "that of Clarabel in the same job. Compare ratios only: machines of jobs differ."
    )
    return "\n".join(["### Smoke set", "", readme_table(history), "", words])


def main() -> None:
    """Print the comment."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.smoke_comment", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("history", type=Path, help="history.json of the page")
    print(smoke_comment(json.loads(parser.parse_args().history.read_text(encoding="utf-8"))))


if __name__ == "__main__":
    main()
