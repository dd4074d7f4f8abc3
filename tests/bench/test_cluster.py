"""Tests of a race on a Dask cluster: the outcomes are those of one machine."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.dask_processes import scheduler, worker
from graspforce.bench import race
from graspforce.bench.cluster import run_batch
from graspforce.bench.conditions import race_conditions
from graspforce.bench.judge import Verdict
from graspforce.bench.outcome import load
from graspforce.core.errors import BackendError

pytest.importorskip("distributed")


def test_race_on_a_cluster_has_the_tasks_and_verdicts_of_the_plan(tmp_path: Path) -> None:
    plan = race.make_race_plan(["structured"], cases=["opposed/force", "opposed/capped"])
    with scheduler(tmp_path) as address, worker(address, "only"):
        _, outcomes = race.run(plan, tmp_path / "outcomes.jsonl", cluster=address)
    assert [one.task for one in outcomes] == list(race.race_tasks(plan))
    assert {one.judgement.verdict for one in outcomes} == {Verdict.CERTIFIED}
    assert {one.task for one in load(tmp_path / "outcomes.jsonl")[1]} == {one.task for one in outcomes}


def test_dead_worker_loses_no_task_and_repeats_none(tmp_path: Path) -> None:
    """Two workers in separate processes, of which one is killed while it works. A third joins later."""
    distributed = pytest.importorskip("distributed")
    plan, save = race.make_race_plan(["structured"], collections=["opposed", "textbook", "ring"]), tmp_path / "outcomes.jsonl"
    with contextlib.ExitStack() as stack:
        address = stack.enter_context(scheduler(tmp_path))
        first, _ = (stack.enter_context(worker(address, name)) for name in ("first", "second"))
        with distributed.Client(address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=120)

        def kill(_: str, done: int, __: int) -> None:
            if done == 20:
                first.send_signal(signal.SIGKILL)
                stack.enter_context(worker(address, "third"))

        facts, outcomes = race.run(plan, save, kill, address)
        assert first.wait() == -signal.SIGKILL
    assert [one.task for one in outcomes] == list(race.race_tasks(plan))
    assert len(save.read_text().splitlines()) == 2 + len(outcomes)  # conditions, clock
    here = race_conditions(plan.solvers, plan.limit)
    assert {name: facts[name] for name in here} == here
    _, local = race.run(plan)
    assert [one.judgement.verdict for one in outcomes] == [one.judgement.verdict for one in local]


def test_worker_under_other_conditions_is_an_error() -> None:
    plan = race.make_race_plan(["structured"], cases=["opposed/force"])
    facts = race_conditions(plan.solvers, plan.limit)
    tasks = list(race.race_tasks(plan))
    assert len(run_batch(tasks, plan.limit, facts)) == 2
    with pytest.raises(BackendError, match=r"other machine than the race: .* instead of another"):
        run_batch(tasks, plan.limit, {**facts, "machine": "another"})
    with pytest.raises(BackendError, match="other versions"):
        run_batch(tasks, plan.limit, {**facts, "versions": {**facts["versions"], "numpy": "0.1"}})


def test_worker_that_cannot_start_processes_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multiprocessing, "current_process", lambda: SimpleNamespace(daemon=True))
    with pytest.raises(BackendError, match="--no-nanny"):
        run_batch([], 1.0, {})
