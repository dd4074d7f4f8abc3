"""Tests of a race on a Dask cluster: the outcomes are those of one machine."""

from __future__ import annotations

import multiprocessing
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.dask_processes import scheduler, worker
from graspforce.bench import race
from graspforce.bench.cluster import run_batch
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


def test_worker_that_cannot_start_processes_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multiprocessing, "current_process", lambda: SimpleNamespace(daemon=True))
    with pytest.raises(BackendError, match="--no-nanny"):
        run_batch([], 1.0)
