"""Import time of the package and of its parts: python -m benchmarks.import_time [--save FILE].

Each row is the time of one statement in a new process, after the statement in the column "after". The requirement is 0.15 s
for `import graspforce` after NumPy.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
from importlib.metadata import version

from benchmarks import report_page

MAX_TIME = 0.15  # s, for `import graspforce` after NumPy
STATEMENTS = (  # timed statement, and statement to run before
    ("import numpy", "pass"),
    ("import graspforce", "import numpy"),
    ("graspforce.solve", "import numpy, graspforce"),
    ("graspforce.Hand", "import numpy, graspforce"),
    ("graspforce.control", "import numpy, graspforce"),
    ("graspforce.planning", "import numpy, graspforce"),
    ("graspforce.service", "import numpy, graspforce"),
)
_TIMER = "import time; {before}; t = time.perf_counter(); {statement}; print(time.perf_counter() - t)"


def import_time(statement: str, before: str) -> float:
    """Return the time of a statement in a new process, s.

    Args:
        statement: timed statement.
        before: statement to run before.
    """
    code = _TIMER.format(statement=statement, before=before)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout)


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("import_time", __doc__)
    parser.add_argument("--rounds", type=int, default=7, help="processes per row (default 7)")
    options = parser.parse_args()
    times = {pair: [] for pair in STATEMENTS}
    for _ in range(options.rounds):
        for pair in STATEMENTS:
            times[pair].append(import_time(*pair))
    rows = []
    for (statement, before), seconds in times.items():
        after = "" if before == "pass" else f"`{before}`"
        rows.append((f"`{statement}`", after, f"{1e3 * min(seconds):.1f}", f"{1e3 * statistics.median(seconds):.1f}"))
    head = ("statement", "after", "minimum ms", "median ms")
    own = statistics.median(times[STATEMENTS[1]])
    facts = report_page.facts(f"NumPy {version('numpy')}")
    facts += (
        f" `import graspforce` takes {1e3 * own:.1f} ms after NumPy: {'met' if own < MAX_TIME else 'missed'}, below 150 ms."
    )
    report_page.show("import times", head, rows)
    print(facts)
    if options.save is not None:
        report_page.save(options.save, "Import time", __doc__, facts, report_page.table(head, rows, text_columns=2))


if __name__ == "__main__":
    main()
