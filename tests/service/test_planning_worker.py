"""Planning processes: their answers, cancellation, and the replacement of dead or hanging ones."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import pytest
from support.plan_requests import HAND, assert_same_plan, decoded_move, hand, moves, slow_move, unreachable_move

from graspforce.planning import Plan
from graspforce.service.wire import protocol
from graspforce.service.wire.plan_records import read_answer, read_progress
from graspforce.service.wire.reply import Reply
from graspforce.service.workers import planning_worker as workers
from graspforce.service.workers.jobs import ANSWER, PlanningJob, WorkerMessage
from graspforce.service.workers.planning_process import run_job
from graspforce.service.workers.planning_worker import PlanningWorker

TIMEOUT = 30.0  # s, enough for a busy machine; only a failing test waits so long

# Replacements of a planning process: each receives a job without reading it, and then does what its name says.
_SILENT = "import sys; from multiprocessing.connection import Connection; p = Connection(int(sys.argv[-1])); p.recv_bytes(); "
DIES = (sys.executable, "-c", _SILENT + "sys.exit(3)")
HANGS = (sys.executable, "-c", _SILENT + "import time; time.sleep(600)")
HANGS_WITH_A_PLAN = (
    sys.executable,
    "-c",
    _SILENT
    + "from graspforce.service.workers.jobs import WorkerMessage, PROGRESS, BEST_SO_FAR; "
    + "from graspforce.service.wire.reply import Reply; "
    + "[p.send(WorkerMessage(kind, Reply(True, b'the best so far', 'application/json'))) for kind in (BEST_SO_FAR, PROGRESS)]; "
    + "import time; time.sleep(600)",
)
DIES_WITH_A_PLAN = (*HANGS_WITH_A_PLAN[:2], HANGS_WITH_A_PLAN[2].replace("time.sleep(600)", "sys.exit(3)"))


def job(record: Any, *, budget: float = 60.0, remaining: float | None = None, sequence: int | None = 3) -> PlanningJob:
    return PlanningJob("me", HAND, record, protocol.MSGPACK, sequence, budget, budget if remaining is None else remaining)


def decoded(reply: Reply) -> Any:
    return protocol.decode(reply.payload, reply.encoding)


@pytest.mark.parametrize("kind", ["path", "free", "fingers"])
def test_answer_is_the_plan_with_the_envelope(kind: str) -> None:
    messages: list[WorkerMessage] = []
    answer = run_job(job(moves()[kind].to_dict()), hand(), messages.append, lambda: False)
    record = decoded(answer.reply)
    assert answer.kind == ANSWER
    assert answer.outcome == "ok"
    assert record.pop("sequence") == 3
    assert 0.0 < record.pop("server_seconds") < TIMEOUT
    assert_same_plan(read_answer(moves()[kind], record), decoded_move(moves()[kind]).plan())
    fractions = [read_progress(decoded(each.reply)).fraction for each in messages if each.kind == "progress"]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0.0


def test_each_better_plan_is_sent_at_once_as_an_answer() -> None:
    messages: list[WorkerMessage] = []
    run_job(job(moves()["free"].to_dict()), hand(), messages.append, lambda: False)
    record = decoded(next(each.reply for each in messages if each.kind == "so far"))
    assert record.pop("sequence") == 3
    record.pop("server_seconds")
    straight = read_answer(moves()["free"], record)
    assert isinstance(straight, Plan)
    assert straight.stopped
    assert straight.check.verified


def test_stopped_failure_names_the_whole_budget() -> None:
    record = decoded(run_job(job(moves()["free"].to_dict(), budget=0.7, remaining=0.0), hand(), [].append, lambda: False).reply)
    assert record["refusal"]["kind"] == "stopped"
    assert record["refusal"]["reason"] == "The budget of 0.7 s ended before there was a first plan."
    assert record["server_seconds"] >= 0.7
    record = decoded(run_job(job(moves()["free"].to_dict()), hand(), [].append, lambda: True).reply)
    assert record["refusal"]["reason"] == "Planning was stopped before there was a first plan."


def test_infeasible_move_is_an_answer_and_invalid_move_an_error() -> None:
    answer = run_job(job(unreachable_move().to_dict()), hand(), [].append, lambda: False)
    assert answer.reply.ok
    assert decoded(answer.reply)["refusal"] == decoded_move(unreachable_move()).plan().to_dict()
    answer = run_job(job({"method": "path"}), hand(), [].append, lambda: False)
    assert not answer.reply.ok
    assert answer.outcome == "invalid"
    error = decoded(answer.reply)
    assert (error["error"], error["field"], error["sequence"]) == ("invalid", "body", 3)


@pytest.fixture
def short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the wait for a process that does not answer."""
    monkeypatch.setattr(workers, "GRACE", 0.05)
    monkeypatch.setattr(workers, "_KILL_DELAY", 0.05)


def cancel_at_first_plan(worker: PlanningWorker) -> Callable[[Reply], None]:
    """Return a progress callback that cancels at the first plan."""

    def progress(reply: Reply) -> None:
        if read_progress(decoded(reply)).best is not None:
            worker.cancel()

    return progress


def run(worker: PlanningWorker, record: Any, budget: float = 60.0) -> tuple[WorkerMessage | None, list[WorkerMessage]]:
    """Return the answer of a worker, and its answers after the deadline."""
    late: list[WorkerMessage] = []
    worker.reserve(budget)
    return worker.plan(job(record, budget=budget), hand(), lambda reply: None, late.append), late


def test_process_runs_many_jobs_and_ends_with_its_worker() -> None:
    worker = PlanningWorker()
    try:
        for kind in ("path", "fingers", "path"):
            answer, late = run(worker, moves()[kind].to_dict())
            assert answer is not None
            assert not late
            record = decoded(answer.reply)
            del record["sequence"], record["server_seconds"]
            assert_same_plan(read_answer(moves()[kind], record), decoded_move(moves()[kind]).plan())
        process = worker._process
        assert process is not None
        late = []
        worker.reserve(60.0)
        answer = worker.plan(job(slow_move().to_dict()), hand(), cancel_at_first_plan(worker), late.append)
        assert decoded((answer or late[0]).reply)["plan"]["stopped"]
        assert process.poll() is None  # the same process for all jobs
    finally:
        worker.close()
    assert process.poll() is not None
    worker.cancel()  # without a process, nothing happens
    worker.close()


@pytest.mark.parametrize(("command", "code"), [(DIES, "internal"), (("/nowhere/python",), "internal")])
def test_dead_process_is_an_error_and_the_next_job_starts_another(command: tuple[str, ...], code: str, caplog) -> None:  # type: ignore[no-untyped-def]
    worker = PlanningWorker(command)
    for _ in range(2):
        answer, late = run(worker, {})
        assert answer is not None
        assert not late
        assert answer.outcome == code
        assert decoded(answer.reply)["sequence"] == 3
    assert "ended" in caplog.text


def test_dead_process_leaves_its_first_plan_as_the_answer() -> None:
    answer, late = run(PlanningWorker(DIES_WITH_A_PLAN), {})
    assert answer is not None
    assert not late
    assert answer.reply.payload == b"the best so far"


def test_hanging_process_is_killed_after_the_answer(short_waits: None) -> None:
    worker = PlanningWorker(HANGS)
    answer, late = run(worker, {}, budget=0.2)
    assert answer is None
    assert len(late) == 1
    assert decoded(late[0].reply)["refusal"]["reason"] == "The budget of 0.2 s ended before there was a first plan."
    assert worker._process is None


def test_best_plan_so_far_answers_for_a_hanging_process(short_waits: None) -> None:
    worker = PlanningWorker(HANGS_WITH_A_PLAN)
    worker.reserve(TIMEOUT)
    late: list[WorkerMessage] = []
    answer = worker.plan(job({}), hand(), lambda reply: worker.cancel(), late.append)
    assert answer is None
    assert [each.reply.payload for each in late] == [b"the best so far"]


def test_job_cancelled_before_it_is_sent_stops_at_once() -> None:
    worker = PlanningWorker()
    worker.reserve(TIMEOUT)
    worker.cancel()
    late: list[WorkerMessage] = []
    answer = worker.plan(job(slow_move().to_dict()), hand(), lambda reply: None, late.append)
    worker.close()
    assert decoded((answer or late[0]).reply)["refusal"]["reason"] == "Planning was stopped before there was a first plan."
