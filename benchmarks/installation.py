"""Sizes and import times of installations: python -m benchmarks.installation [--python P ...].

Each row is a new virtual environment, into which pip installs a copy of this checkout, without compiled parts, with the extras.
The size is the sum of all files that the installation added, without pip itself. Times are medians of new processes: `import
graspforce`, and `import` and the first certified solution of two opposed contacts together. The requirement is 300 MB for the
core. Without a C compiler there is no structured solver, and Clarabel solves.
"""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from rich.progress import track

from benchmarks import report_page

ROOT = Path(__file__).parents[1]
MAX_CORE = 300.0  # MB
BUILT = ("build", "dist", "*.egg-info", "*.so", "__pycache__", ".*")  # is left out of the copy
EXTRAS = ("", "hand", "plan", "serve", "plot", "sim", "all")
_TIMER = "import time; t = time.perf_counter(); {statement}; print(time.perf_counter() - t)"
_SOLVE = """
contacts = [gf.Contact(position=[0, y, 0], normal=[0, -y / 0.03, 0], friction=0.5, max_normal=20) for y in (-0.03, 0.03)]
solution = gf.solve(gf.ForceProblem(contacts, w=[0, 0, 1.962, 0, 0, 0]))
assert solution.status.value == "optimal", solution
"""


def installed_megabytes(environment: Path) -> float:
    """Return the size of all files in an environment, MB (10⁶ bytes).

    Args:
        environment: root of the virtual environment.
    """
    return sum(file.lstat().st_size for file in environment.rglob("*") if not file.is_symlink()) / 1e6


def median_time(python: Path, code: str, rounds: int) -> float:
    """Return the median time that code takes in new processes, s.

    Args:
        python: interpreter.
        code: code that prints its time.
        rounds: number of processes.
    """
    runs = [
        subprocess.run([python, "-c", code], capture_output=True, text=True, check=True, cwd=tempfile.gettempdir())
        for _ in range(rounds)
    ]
    return statistics.median(float(run.stdout.splitlines()[-1]) for run in runs)


def measure(python: str, extra: str, compiled: bool, rounds: int) -> tuple[str, ...]:
    """Return the row of one installation.

    Args:
        python: name of the interpreter.
        extra: extra of graspforce; empty for the core.
        compiled: whether a C compiler is available.
        rounds: number of processes for each time.
    """
    with tempfile.TemporaryDirectory() as folder:
        environment = Path(folder) / "environment"
        subprocess.run([python, "-m", "venv", "--upgrade-deps", environment], check=True)
        before = installed_megabytes(environment)
        own = environment / "bin" / "python"
        variables = os.environ if compiled else {**os.environ, "CC": "false", "CXX": "false"}
        source = shutil.copytree(ROOT, Path(folder) / "source", ignore=shutil.ignore_patterns(*BUILT))
        target = f"{source}[{extra}]" if extra else str(source)
        install = [own, "-m", "pip", "install", "--quiet", "--no-compile", target]
        subprocess.run(install, check=True, env=variables, stderr=subprocess.DEVNULL)
        size = installed_megabytes(environment) - before
        imported = median_time(own, _TIMER.format(statement="import graspforce"), rounds)
        solve = f"import time; t = time.perf_counter()\nimport graspforce as gf\n{_SOLVE}\nprint(time.perf_counter() - t)"
        solved = median_time(own, solve, rounds)
        code = "import sys, graspforce as gf; print(sys.version.split()[0], *gf.available_backends())"
        named = subprocess.run([own, "-c", code], capture_output=True, text=True, check=True, cwd=tempfile.gettempdir())
        version, *backends = named.stdout.split()
    name = (extra or "core") + ("" if compiled else ", no C compiler")
    return (name, version, " ".join(backends), f"{size:.0f}", f"{1e3 * imported:.0f}", f"{1e3 * solved:.0f}")


def main() -> None:
    """Install, measure, print the table and write the page."""
    parser = report_page.parser("installation", __doc__)
    parser.add_argument("--python", nargs="+", default=[sys.executable], help="interpreters (default: this one)")
    parser.add_argument("--extras", nargs="*", default=list(EXTRAS), help="extras; '' for the core (default: the main ones)")
    parser.add_argument("--without-compiler", action="store_true", help="also install the core without a C compiler")
    parser.add_argument("--rounds", type=int, default=5, help="processes for each time (default 5)")
    options = parser.parse_args()
    cases = [(python, extra, True) for python in options.python for extra in options.extras]
    if options.without_compiler:
        cases += [(python, "", False) for python in options.python]
    rows = [measure(*case, options.rounds) for case in track(cases, description="Installing")]
    head = ("extra", "Python", "solvers", "size MB", "import ms", "import and first solution ms")
    largest = max((float(row[3]) for row in rows if row[0].startswith("core")), default=0.0)
    facts = report_page.facts("pip without byte code")
    facts += f" The core takes at most {largest:.0f} MB: {'met' if largest <= MAX_CORE else 'missed'}, below {MAX_CORE:.0f} MB."
    report_page.show("Installations", head, rows)
    print(facts)
    if options.save is not None:
        report_page.save(options.save, "Installation", __doc__, facts, report_page.table(head, rows, text_columns=3))


if __name__ == "__main__":
    main()
