"""Size and contents of the data package: `python -m benchmarks.data_package [--outcomes FILE] [--save FILE]` (extra `bench`).

The package graspforce-problems is written with all cases, built as a wheel, and installed in a new environment, where its own
reader checks every hash. The environment has no packages but this one and those that it needs.

The second table counts the cases of each difficulty. With `--outcomes`, a file of `python -m benchmarks.suite run` or
`graspforce bench`, it also shows how often the solvers were correct on cases of a difficulty or trait, with the settings "high"
and a cold start; unsupported cases are not counted there.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from rich.progress import Progress

from benchmarks import report_page
from graspforce.bench import outcome as outcome_file
from graspforce.bench.export.data_package import write_data_package
from graspforce.bench.export.tags import TRAITS, case_tags
from graspforce.bench.judge import CORRECT_VERDICTS, Verdict
from graspforce.bench.outcome import RaceOutcome
from graspforce.problems import DATA_VERSION, load, names

LIMIT = 20.0  # MB, of the wheel
HEAD = ("quantity", "measured", "required")
TAG_HEAD = ("tag", "cases", "answers", "correct")
LEVELS = ("difficulty:easy", "difficulty:medium", "difficulty:hard")
READER = """
import json, graspforce_problems as package
manifest = package.manifest()
facts = {"cases": len(package.names()), "changed": len(package.check_hashes())}
print(json.dumps({**facts, "version": manifest["version"], "licence": manifest["licence"]}))
"""


def main() -> None:
    """Write, build, install and check the package, and print its tables."""
    parser = report_page.parser("data_package", __doc__)
    parser.add_argument("--outcomes", type=Path, help="outcomes of solvers, for the table of difficulties")
    options = parser.parse_args()
    outcomes = [] if options.outcomes is None else outcome_file.load(options.outcomes)[1]
    with tempfile.TemporaryDirectory() as folder, Progress() as bar:
        task = bar.add_task("writing the cases", total=None)
        source = Path(folder) / "package"
        write_data_package(source, progress=lambda done, total: bar.update(task, completed=done, total=total))
        wheel = build_wheel(source, Path(folder))
        facts, packages = read_in_new_environment(wheel, Path(folder))
        size, data = wheel.stat().st_size / 1e6, folder_size(source) / 1e6  # MB
    rows = [
        ("wheel", f"{size:.1f} MB", f"< {LIMIT:g} MB"),
        ("folder of the package", f"{data:.1f} MB", "–"),
        ("cases", str(facts["cases"]), "≥ 6000"),
        ("files and cases whose hash differs", str(facts["changed"]), "0"),
        ("version of the data", str(facts["version"]), DATA_VERSION),
        ("licence", str(facts["licence"]), "CC-BY-4.0"),
        ("packages beside it and pip", ", ".join(packages), "numpy"),
    ]
    tags = tag_rows(outcomes)
    report_page.show("Data package", HEAD, rows)
    report_page.show("Difficulty", TAG_HEAD, tags)
    if options.save:
        tables = [report_page.table(HEAD, rows, 2), "## Difficulty", report_page.table(TAG_HEAD, tags)]
        report_page.save(options.save, "Data package", __doc__, report_page.facts(), "\n\n".join(tables))


def build_wheel(source: Path, folder: Path) -> Path:
    """Build the wheel of a package, and return its path.

    Args:
        source: the package.
        folder: folder of the wheel.
    """
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(source)]
    subprocess.run(pip, check=True)
    [wheel] = folder.glob("*.whl")
    return wheel


def read_in_new_environment(wheel: Path, folder: Path) -> tuple[dict[str, object], list[str]]:
    """Install a wheel in a new environment, and return the facts of its reader and the names of the other installed packages.

    Args:
        wheel: the wheel.
        folder: folder of the environment.
    """
    environment = folder / "environment"
    subprocess.run([sys.executable, "-m", "venv", "--upgrade-deps", str(environment)], check=True, capture_output=True)
    python = str(environment / "bin" / "python")
    subprocess.run([python, "-m", "pip", "install", "--quiet", str(wheel)], check=True)
    read = subprocess.run([python, "-c", READER], check=True, capture_output=True, text=True).stdout
    listed = subprocess.run([python, "-m", "pip", "list", "--format=json"], check=True, capture_output=True, text=True).stdout
    others = {each["name"] for each in json.loads(listed)} - {"graspforce-problems", "pip", "setuptools"}
    return json.loads(read), sorted(others)


def folder_size(folder: Path) -> int:
    """Return the bytes of all files of a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def tag_rows(outcomes: list[RaceOutcome]) -> list[tuple[str, ...]]:
    """Return for each difficulty and trait the number of cases, of supported runs, and the share of correct ones.

    Args:
        outcomes: outcomes of solvers; empty for none.
    """
    tags = {name: case_tags(load(name)) for name in names()}
    answers: Counter[str] = Counter()
    correct: Counter[str] = Counter()
    for outcome in outcomes:
        task, verdict = outcome.task, outcome.judgement.verdict
        if task.settings != "high" or task.warm or verdict is Verdict.UNSUPPORTED:
            continue
        answers.update(tags[task.case])
        if verdict in CORRECT_VERDICTS:
            correct.update(tags[task.case])
    cases = Counter(tag for each in tags.values() for tag in each)
    return [
        (tag, str(cases[tag]), str(answers[tag]), f"{100.0 * correct[tag] / answers[tag]:.1f} %" if answers[tag] else "–")
        for tag in (*LEVELS, *TRAITS)
    ]


if __name__ == "__main__":
    main()
