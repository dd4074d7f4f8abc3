"""Tests of the README's table: it has the numbers of the page of results."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import readme_table as command
from graspforce.bench.judge import CORRECT_VERDICTS, Judgement, Verdict
from graspforce.bench.outcome import RaceOutcome, RaceTask
from graspforce.bench.readme_table import BEGIN, END, GROUPS, readme_table, replace_table
from graspforce.bench.site import write_site
from graspforce.bench.statistics import group_outcomes, summarize_solvers
from graspforce.core.errors import InvalidInput

CONDITIONS = {"machine": "m", "cores": 2, "python": "3.12", "limit": 0.5, "versions": {"graspforce": "1", "clarabel": "2"}}


def outcomes() -> list[RaceOutcome]:
    """Return outcomes of two solvers, of which one takes pyramids only."""
    made = []
    for solver, pyramids, seconds in (("clarabel", (False, True), 1e-3), ("other", (True,), 3e-3)):
        for pyramid in pyramids:
            for i, case in enumerate(("opposed/force", "ring/3-force", "ring/3-torque")):
                verdict = Verdict.WRONG if (solver, i) == ("other", 2) else Verdict.CERTIFIED
                time = None if verdict is Verdict.WRONG else seconds
                task = RaceTask(solver, "default", "scaled", pyramid, False, case)
                made.append(RaceOutcome(task, 3, True, Judgement(verdict, 1e-9), time, None, 5))
    return made


def test_readme_has_the_numbers_of_the_committed_page() -> None:
    text = (command.ROOT / "README.md").read_text()
    table = readme_table(json.loads(command.HISTORY.read_text()))
    assert f"{BEGIN}\n{table}\n{END}" in text
    report = (command.HISTORY.parent / "report.md").read_text()
    for entry in json.loads(command.HISTORY.read_text()):  # the report is of the same race
        share = f"{100.0 * entry['correct'] / entry['cases']:.1f} %"
        assert f"| {entry['solver']} {entry['version']} | {entry['cases']} |" in report
        assert share in report


def test_table_has_the_numbers_of_the_statistics(tmp_path: Path) -> None:
    write_site(tmp_path, CONDITIONS, outcomes(), "graspforce bench")
    table = readme_table(json.loads((tmp_path / "history.json").read_text()))
    head, _, *rows = table.splitlines()
    assert head.count("|") == 2 + 3 * len(GROUPS)
    cells = {row.split("|")[1].strip(): [cell.strip() for cell in row.split("|")[2:-1]] for row in rows}
    assert cells["other"][:3] == ["–", "–", "–"]
    for group, first in zip(group_outcomes(outcomes()), (0, 3), strict=True):
        summaries = {one.solver: one for one in summarize_solvers(group, CONDITIONS["limit"])}
        for solver, summary in summaries.items():
            correct = sum(summary.counts[verdict] for verdict in CORRECT_VERDICTS)
            assert cells[solver][first] == f"{correct} of {summary.attempted}"
            assert cells[solver][first + 1] == str(summary.counts[Verdict.WRONG])
            assert cells[solver][first + 2] == f"{summary.mean / summaries['clarabel'].mean:.1f} ×"


def test_command_replaces_the_table_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_site(tmp_path, CONDITIONS, outcomes(), "graspforce bench")
    readme = tmp_path / "README.md"
    readme.write_text(f"before\n\n{BEGIN}\n| old |\n{END}\n\nafter\n")
    options = ["--history", str(tmp_path / "history.json"), "--readme", str(readme)]
    for _ in range(2):
        monkeypatch.setattr("sys.argv", ["readme_table", *options])
        command.main()
    text = readme.read_text()
    assert text.startswith(f"before\n\n{BEGIN}\n| solver |")
    assert text.endswith(f"|\n{END}\n\nafter\n")
    assert "old" not in text


def test_missing_marks_or_reference_are_errors() -> None:
    with pytest.raises(InvalidInput, match="a text with the lines"):
        replace_table("no marks", "table")
    with pytest.raises(InvalidInput, match="results with the solver clarabel"):
        readme_table([{"group": "exact cones, default, scaled", "solver": "other", "cases": 1, "correct": 1, "wrong": 0}])
