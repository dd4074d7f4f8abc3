"""Tests of the answers-only track: files of every kind get the verdicts that the running solver gets."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import graspforce as gf
from graspforce import problems
from graspforce.bench.answers import check_unique, judge_answers, load_answers
from graspforce.bench.judge import Verdict
from graspforce.bench.registry import load_adapter
from graspforce.bench.worker import load_case_problem
from graspforce.cli import main
from graspforce.force.cone_program import conic_program

pyarrow = pytest.importorskip("pyarrow")


def row(case: str, cone: str = "exact", settings: str = "default") -> dict[str, Any]:
    """Return an answer by Clarabel."""
    import clarabel  # noqa: F401  the solver of the answers

    problem, _ = load_case_problem(case, cone == "pyramid")
    program = conic_program(problem)
    output = load_adapter("clarabel").bind(program, settings).run(None)
    e, i = len(program.b), len(program.d)
    dual = np.array(output.z)
    status = {"Solved": "solved", "PrimalInfeasible": "infeasible"}[str(output.status)]
    x = list(output.x) if status == "solved" else []
    y, z = list(-dual[:e]), list(np.maximum(dual[e : e + i], 0.0))
    return {"case": case, "cone": cone, "settings": settings, "status": status, "x": x, "y": y, "z": z, "seconds": 2e-3}


def write(path: Path, rows: list[dict[str, Any]]) -> Path:
    """Write rows as Parquet, JSON or CSV, by the ending."""
    if path.suffix == ".json":
        path.write_text(json.dumps(rows))
    elif path.suffix == ".parquet":
        import pyarrow.parquet

        pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows), path)
    else:
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            flat = [
                {k: " ".join(repr(float(n)) for n in v) if isinstance(v, list) else v for k, v in one.items()} for one in rows
            ]
            writer.writerows(flat)
    return path


@pytest.mark.parametrize("ending", [".parquet", ".json", ".csv"])
def test_every_kind_of_file_gives_the_same_verdicts(tmp_path: Path, ending: str) -> None:
    rows = [row("ring/3-force"), row("opposed/capped"), row("ring/3-torque", "pyramid", "high")]
    rows.append({**rows[0], "y": [], "z": []})  # no multipliers
    rows.append({**rows[0], "settings": "high", "x": [1.001 * value for value in rows[0]["x"]]})
    rows.append({**rows[0], "status": "no answer"})
    found = judge_answers("mine", load_answers(write(tmp_path / f"mine{ending}", rows)))
    verdicts = [Verdict.CERTIFIED, Verdict.CERTIFIED, Verdict.CERTIFIED, Verdict.CORRECT, Verdict.WRONG, Verdict.NO_ANSWER]
    assert [one.judgement.verdict for one in found] == verdicts
    assert [one.seconds for one in found] == [2e-3, 2e-3, 2e-3, 2e-3, None, None]
    assert all(one.time_is_reported and one.task.solver == "mine" for one in found)
    assert type(found[0]).from_dict(json.loads(json.dumps(found[0].to_dict()))) == found[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x": [1.0]}, r"rows\[0\]\.x = '1 numbers': must be 9 numbers"),
        ({"status": "optimal"}, r"rows\[0\]\.status = 'optimal'"),
        ({"cone": "round"}, r"rows\[0\]\.cone"),
        ({"settings": "best"}, r"rows\[0\]\.settings"),
        ({"seconds": -1.0}, r"rows\[0\]\.seconds"),
        ({"case": "ring/none"}, "ring/none"),
        ({"forces": 1.0}, "forces"),
    ],
)
def test_errors_name_row_and_column(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    path = write(tmp_path / "mine.json", [{**row("ring/3-force"), **change}])
    with pytest.raises(gf.GraspForceError, match=message):
        judge_answers("mine", load_answers(path))


def test_other_files_are_rejected(tmp_path: Path) -> None:
    for name, text in (("a.txt", ""), ("a.json", "[]"), ("b.json", "{"), ("c.json", "[1]"), ("a.csv", "case,status\n")):
        (tmp_path / name).write_text(text)
        with pytest.raises(gf.InvalidInput, match="answers"):
            load_answers(tmp_path / name)


def test_a_case_counts_once(tmp_path: Path) -> None:
    rows = [row("ring/3-force"), row("ring/3-torque"), row("ring/3-force")]
    with pytest.raises(gf.InvalidInput, match=r"rows\[2\].case = 'ring/3-force': must be the only answer"):
        check_unique(load_answers(write(tmp_path / "mine.json", rows)))
    check_unique(load_answers(write(tmp_path / "once.json", rows[:2])))


def test_command_judges_answers_without_running_a_solver(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "mine.json", [row("ring/3-force")])
    assert main(["bench", "--answers", str(path), "--report", str(tmp_path / "page")]) == 0
    assert "mine" in capsys.readouterr().out
    page = (tmp_path / "page" / "report.md").read_text()
    assert "mine (answers only, times reported)" in page
    assert "mine (reported)" in page


def test_smoke_set_has_160_cases_of_every_collection_and_kind() -> None:
    from graspforce.bench.export.tags import case_tags

    names = problems.smoke_names()
    assert len(names) == len(set(names)) == 160
    assert {name.split("/")[0] for name in names} == set(problems.collections())
    tags = {tag for name in names for tag in case_tags(problems.load(name))}
    kinds = {"exact", "pyramid", "feasible", "infeasible", "soft", "motor-limits", "low-friction", "rank-deficient", "linear"}
    assert kinds | {f"objective:{kind}" for kind in ("force", "torque", "max_normal", "sum_normal", "margin")} <= tags
