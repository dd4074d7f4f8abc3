"""Tests of long races: blocks and slices of cases, several workers at once, merged and packed records."""

from __future__ import annotations

import dataclasses
import threading
from collections import Counter
from pathlib import Path

import pytest

from benchmarks import suite
from graspforce import problems
from graspforce.bench import local_workers, race, report
from graspforce.bench.blocks import BLOCKS, case_blocks, order_in_blocks, select_slice, task_units
from graspforce.bench.case_sequences import SEQUENCE_COLLECTIONS, sequence_name
from graspforce.bench.judge import Judgement, Verdict
from graspforce.bench.local_workers import run_tasks_here
from graspforce.bench.merge import merge_races, pack
from graspforce.bench.outcome import RaceOutcome, RaceTask, append, append_clock, load, write_header
from graspforce.core.errors import InvalidInput

CASES = ("ring/3-force", "opposed/capped", "trajectory/carry-1-000", "trajectory/carry-1-001")
CLOCK = {"governor": None, "mhz": 3000.0, "throttle_count": None}


def outcome(solver: str, case: str, verdict: Verdict = Verdict.CERTIFIED, seconds: float | None = 1.23456e-4) -> RaceOutcome:
    task = RaceTask(solver, "default", "scaled", False, False, case)
    return RaceOutcome(task, 3, True, Judgement(verdict, 1.23456e-9), seconds, None, 7)


def conditions(machine: str = "m", **change: object) -> dict[str, object]:
    facts = {"machine": machine, "cores": 2, "python": "3.11", "limit": 1.0, "versions": {"a": "1", "b": "2"}}
    return {**facts, "problems": {"version": "2", "sha256": "0" * 64}, **change}


def write(path: Path, facts: dict[str, object], outcomes: list[RaceOutcome]) -> Path:
    write_header(path, facts)
    for one in outcomes:
        append(path, one)
    append_clock(path, {"before": CLOCK, "after": CLOCK, "workers": 2})
    return path


# ── blocks ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_every_block_samples_every_large_collection_and_keeps_sequences_whole() -> None:
    blocks = case_blocks()
    assert set(blocks) == set(problems.names())
    for collection in set(problems.collections()) - set(SEQUENCE_COLLECTIONS):
        count = Counter(block for name, block in blocks.items() if name.startswith(f"{collection}/"))
        size = len(problems.names(collection))
        assert set(count.values()) <= {size // BLOCKS, size // BLOCKS + 1}, collection
        assert len(count) == min(size, BLOCKS), collection
    for collection in SEQUENCE_COLLECTIONS:
        whole = {(sequence_name(name), blocks[name]) for name in problems.names(collection)}
        assert len(whole) == len({sequence for sequence, _ in whole})


def test_slices_hold_every_task_once() -> None:
    plan = race.make_race_plan(("structured", "clarabel"), collections=("textbook",), max_cases=0)
    tasks = order_in_blocks(race.race_tasks(plan))
    parts = [select_slice(tasks, part, 7) for part in range(1, 8)]
    assert sorted(map(repr, tasks)) == sorted(repr(task) for part in parts for task in part)
    units = task_units(tasks)
    assert [task for unit in units for task in unit] == tasks
    blocks = case_blocks()
    assert len(units) == len({(blocks[task.case], task.solver) for task in tasks})


@pytest.mark.parametrize(
    ("part", "parts", "allowed"), [(0, 4, "K from 1 to 4"), (5, 4, "K from 1 to 4"), (1, 61, "from 1 to 60")]
)
def test_impossible_slices_are_rejected(part: int, parts: int, allowed: str) -> None:
    with pytest.raises(InvalidInput, match=allowed):
        select_slice([], part, parts)


# ── workers ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_several_workers_find_the_verdicts_of_one() -> None:
    plan = race.make_race_plan(("structured", "clarabel"), limit=2.0, cases=CASES)
    _, alone = race.run(plan)
    facts, together = race.run(plan, workers=2)
    found = {one.task: one.judgement.verdict for one in together}
    assert found == {one.task: one.judgement.verdict for one in alone}
    assert facts["clocks"][0]["workers"] == 2
    with pytest.raises(InvalidInput, match="workers = 0"):
        race.run(plan, workers=0)


class CountingWorker:
    """Worker that returns at once, and counts how many exist."""

    made: list[int]

    def __init__(self, limit: float) -> None:
        self.made.append(threading.get_ident())

    def __enter__(self) -> CountingWorker:
        return self

    def __exit__(self, *_: object) -> None:
        self.made.append(-1)

    def run(self, task: RaceTask) -> RaceOutcome:
        if task.case == "opposed/capped":
            raise OSError("no processes left")
        return outcome(task.solver, task.case)


@pytest.fixture
def counting(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    made: list[int] = []
    monkeypatch.setattr(CountingWorker, "made", made, raising=False)
    monkeypatch.setattr(local_workers, "Worker", CountingWorker)
    return made


def test_a_solver_keeps_its_process_and_all_processes_are_closed(counting: list[int]) -> None:
    tasks = [outcome(solver, case).task for case in problems.names("ring")[:2] for solver in ("a", "b")]
    assert [one.task for one in run_tasks_here(tasks, 1.0)] == tasks
    assert len([one for one in counting if one >= 0]) == 2
    assert counting.count(-1) == 2


def test_no_task_starts_after_the_stop(counting: list[int]) -> None:
    tasks, starts = [outcome("a", case).task for case in problems.names("ring")], iter(range(100))
    done = list(run_tasks_here(tasks, 1.0, 1, lambda: next(starts) >= 3))
    assert [one.task for one in done] == tasks[:3]


def test_an_error_of_a_worker_reaches_the_caller(counting: list[int]) -> None:
    with pytest.raises(OSError, match="no processes left"):
        list(run_tasks_here([outcome("a", "opposed/capped").task], 1.0, 2))


# ── records ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_merged_parts_hold_every_outcome_and_name_their_machines(tmp_path: Path) -> None:
    first = write(tmp_path / "1.jsonl", conditions("m"), [outcome("a", "x"), outcome("b", "x")])
    again = write(tmp_path / "2.jsonl", conditions("m"), [outcome("a", "x", Verdict.WRONG), outcome("a", "y")])
    other = write(tmp_path / "3.jsonl", conditions("n"), [outcome("a", "z")])
    facts, outcomes = merge_races([first, again, other])
    assert [(one.task.solver, one.task.case) for one in outcomes] == [("a", "x"), ("b", "x"), ("a", "y"), ("a", "z")]
    assert outcomes[0].judgement.verdict is Verdict.CERTIFIED  # of the first file
    assert [(one["machine"], one["tasks"]) for one in facts["sessions"]] == [("m", {"a": 2, "b": 1}), ("n", {"a": 1})]

    packed = tmp_path / "packed.jsonl.xz"
    pack(packed, facts, outcomes)
    stored = load(packed)[1]
    assert [one.task for one in stored] == sorted((one.task for one in outcomes), key=dataclasses.astuple)
    assert (stored[0].seconds, stored[0].judgement.residual) == (1.235e-4, 1.23e-9)
    late = write(tmp_path / "4.jsonl", conditions("n"), [outcome("b", "z"), outcome("a", "z")])
    facts, more = merge_races([packed, late])
    assert len(more) == 5
    assert facts["sessions"][1]["tasks"] == {"a": 1, "b": 1}

    text = " ".join(report.write(tmp_path / "page", {**facts, "missing": 9}, more, "bench").read_text().split())
    assert "The race is not complete: 9 runs are missing." in text
    assert "m, 2 cores, Python 3.11. It ran 3 runs: a 2, b 1. Up to 2 solvers ran at once" in text
    assert "n, 2 cores, Python 3.11. It ran 2 runs: a 1, b 1." in text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"limit": 2.0}, "another limit"),
        ({"problems": {"version": "3", "sha256": "1"}}, "another problems"),
        ({"versions": {"a": "1.1", "b": "2"}}, "another version of a"),
    ],
)
def test_parts_of_different_races_are_not_merged(tmp_path: Path, change: dict[str, object], message: str) -> None:
    first = write(tmp_path / "1.jsonl", conditions(), [outcome("a", "x")])
    second = write(tmp_path / "2.jsonl", conditions(**change), [outcome("a", "y")])
    with pytest.raises(InvalidInput, match=message):
        merge_races([first, second])
    with pytest.raises(InvalidInput, match="a file that ends in"):
        pack(tmp_path / "packed.jsonl", conditions(), [])


# ── the command ────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_suite_covers_every_case_and_is_resumed_slice_by_slice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, hard, smoke = suite.suite_plans(("clarabel",))
    assert set(race.select_cases(whole.collections, whole.max_cases)) == set(problems.names())
    assert (hard.units, hard.settings, len(smoke.cases)) == (("si",), ("default", "high"), 160)

    small = dataclasses.replace(whole, cases=CASES)
    monkeypatch.setattr(suite, "suite_plans", lambda _: (small, dataclasses.replace(small, units=("si",))))
    monkeypatch.setattr(suite, "_ENVIRONMENT", {})
    files = [tmp_path / f"{part}.jsonl" for part in (1, 2)]
    assert suite.main(["run", "--save", str(files[0]), "--slice", "1/2", "--minutes", "0"]) == 0
    assert load(files[0])[1] == []
    for part, path in enumerate(files, 1):
        assert suite.main(["run", "--save", str(path), "--slice", f"{part}/2"]) == 0
    before = [path.read_text() for path in files]
    assert suite.main(["run", "--save", str(files[0]), "--skip", str(files[1])]) == 0
    assert [path.read_text() for path in files] == before  # every task is done

    record = tmp_path / "run.jsonl.xz"
    assert suite.main(["pages", *map(str, files), "--record", str(record), "--results", str(tmp_path)]) == 0
    assert {one.task for one in load(record)[1]} == set(suite.suite_tasks(suite.suite_plans(())))
    for folder in ("suite", "suite-hard"):
        text = (tmp_path / folder / "report.md").read_text()
        assert "| clarabel" in text
        assert "not complete" not in text
    assert suite.main(["compare", str(record), str(files[0])]) == 0
    assert "0 verdicts differ" in capsys.readouterr().out


def test_comparison_fails_for_a_difference_that_is_not_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    varying = dataclasses.replace(outcome("a", "y"), verdict_varies=True)
    first = write(tmp_path / "1.jsonl", conditions(), [outcome("a", "x"), varying])
    same = write(tmp_path / "2.jsonl", conditions(), [outcome("a", "x"), outcome("a", "y", Verdict.INEXACT)])
    other = write(tmp_path / "3.jsonl", conditions(), [outcome("a", "x", Verdict.WRONG), varying])
    assert suite.main(["compare", str(first), str(same)]) == 0
    assert "a y (default scaled exact): certified → inexact (named as varying)" in capsys.readouterr().out
    assert suite.main(["compare", str(first), str(other)]) == 1
    assert "2 tasks in both: 1 verdicts differ, of which 0 are named as varying." in capsys.readouterr().out


def test_pages_mark_tasks_that_a_second_run_judges_differently(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(suite, "suite_plans", lambda _: ())
    made = [outcome("clarabel", name) for name in ("opposed/force", "ring/3-force", "ring/3-torque")]
    first = write(tmp_path / "1.jsonl", conditions(), made)
    other = outcome("clarabel", "ring/3-force", Verdict.TIMED_OUT)
    second = write(tmp_path / "2.jsonl", conditions(), [made[0], other])
    record = tmp_path / "run.jsonl.xz"
    options = ["--repeat", str(second), "--record", str(record), "--results", str(tmp_path)]
    assert suite.main(["pages", str(first), *options]) == 0
    kept = {one.task.case: (one.judgement.verdict, one.verdict_varies) for one in load(record)[1]}
    assert kept["ring/3-force"] == (Verdict.TIMED_OUT, True)
    assert kept["opposed/force"] == kept["ring/3-torque"] == (Verdict.CERTIFIED, False)
    page = (tmp_path / "suite" / "repeat.md").read_text()
    assert "2 tasks ran in both: 1 verdicts differ (50.000 %), 1 of them" in page
    assert "| clarabel | ring/3-force | default scaled exact | certified | timed out |" in page
    assert suite.main(["compare", str(record), str(second)]) == 0  # every difference is named
