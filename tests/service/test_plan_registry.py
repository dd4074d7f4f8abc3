"""Plans under way, without a network: one answer each, whatever the request, the process that plans, or the clock does."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
from support.plan_requests import HAND, assert_same_plan, decoded_move, hand, moves, slow_move, unreachable_move

from graspforce.planning import Plan
from graspforce.service.server.plan_registry import PlanRegistry
from graspforce.service.wire import protocol
from graspforce.service.wire.plan_records import read_answer, read_progress, write_move
from graspforce.service.wire.reply import Reply
from graspforce.service.workers import planning_worker as workers
from graspforce.service.workers.jobs import ANSWER, PlanningJob, WorkerMessage
from graspforce.service.workers.planning_process import run_job, worker_environment
from graspforce.service.workers.planning_worker import PlanningWorker

KEY = f"hands/{HAND}/plan"
PATIENCE = 30.0  # s: long enough for a busy machine; no test waits for it unless it fails

# In place of a planning process: takes a job without reading it, and then …
_SILENT = "import sys; from multiprocessing.connection import Connection; p = Connection(int(sys.argv[-1])); p.recv_bytes(); "
DIES = (sys.executable, "-c", _SILENT + "sys.exit(3)")
HANGS = (sys.executable, "-c", _SILENT + "import time; time.sleep(600)")
HANGS_WITH_A_PLAN = (
    sys.executable,
    "-c",
    _SILENT
    + "from graspforce.service.workers.jobs import WorkerMessage, PROGRESS, BEST_SO_FAR; from graspforce.service.wire.reply import Reply; "
    + "[p.send(WorkerMessage(kind, Reply(True, b'the best so far', 'application/json'))) for kind in (BEST_SO_FAR, PROGRESS)]; "
    + "import time; time.sleep(600)",
)
DIES_WITH_A_PLAN = (*HANGS_WITH_A_PLAN[:2], HANGS_WITH_A_PLAN[2].replace("time.sleep(600)", "sys.exit(3)"))


def job(record: Any, *, budget: float = 60.0, remaining: float | None = None, sequence: int | None = 3) -> PlanningJob:
    return PlanningJob("me", HAND, record, protocol.MSGPACK, sequence, budget, budget if remaining is None else remaining)


def decoded(reply: Reply) -> Any:
    return protocol.decode(reply.payload, reply.encoding)


# ── what a planning process does ──────────────────────────────────────────────────────────────────────────────────────────────


def test_a_planning_process_keeps_to_one_thread_whatever_the_server_s_environment_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.setenv("LANG", "C.UTF-8")
    assert worker_environment()["OMP_NUM_THREADS"] == "1"
    assert worker_environment()["LANG"] == "C.UTF-8"


@pytest.mark.parametrize("kind", ["path", "free", "fingers"])
def test_the_answer_is_the_plan_with_the_envelope(kind: str) -> None:
    told: list[WorkerMessage] = []
    said = run_job(job(write_move(moves()[kind])), hand(), told.append, lambda: False)
    record = decoded(said.reply)
    assert said.kind == ANSWER
    assert said.outcome == "ok"
    assert record.pop("sequence") == 3
    assert 0.0 < record.pop("server_seconds") < PATIENCE
    assert_same_plan(read_answer(moves()[kind], record), decoded_move(moves()[kind]).plan())
    fractions = [read_progress(decoded(each.reply)).fraction for each in told if each.kind == "progress"]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0.0


def test_every_better_plan_is_said_at_once_as_an_answer_that_would_do() -> None:
    told: list[WorkerMessage] = []
    run_job(job(write_move(moves()["free"])), hand(), told.append, lambda: False)
    record = decoded(next(each.reply for each in told if each.kind == "so far"))
    assert record.pop("sequence") == 3
    record.pop("server_seconds")
    straight = read_answer(moves()["free"], record)
    assert isinstance(straight, Plan)
    assert straight.stopped
    assert straight.check.verified


def test_a_spent_budget_is_said_in_words_of_the_whole_of_it() -> None:
    record = decoded(
        run_job(job(write_move(moves()["free"]), budget=0.7, remaining=0.0), hand(), [].append, lambda: False).reply
    )
    assert record["refusal"]["kind"] == "stopped"
    assert record["refusal"]["reason"] == "The budget of 0.7 s ended before there was a first plan."
    assert record["server_seconds"] >= 0.7
    record = decoded(run_job(job(write_move(moves()["free"])), hand(), [].append, lambda: True).reply)
    assert record["refusal"]["reason"] == "Planning was stopped before there was a first plan."


def test_what_cannot_be_is_an_answer_and_what_is_no_move_an_error() -> None:
    said = run_job(job(write_move(unreachable_move())), hand(), [].append, lambda: False)
    assert said.reply.ok
    assert decoded(said.reply)["refusal"] == decoded_move(unreachable_move()).plan().to_dict()
    said = run_job(job({"method": "path"}), hand(), [].append, lambda: False)
    assert not said.reply.ok
    assert said.outcome == "invalid"
    error = decoded(said.reply)
    assert (error["error"], error["field"], error["sequence"]) == ("invalid", "body", 3)


# ── the process ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits long for a process that does not answer."""
    monkeypatch.setattr(workers, "GRACE", 0.05)
    monkeypatch.setattr(workers, "_KILL_DELAY", 0.05)


def cancelling(planner: PlanningWorker) -> Callable[[Reply], None]:
    """Cancels as soon as there is a plan."""

    def progress(reply: Reply) -> None:
        if read_progress(decoded(reply)).best is not None:
            planner.cancel()

    return progress


def planned(planner: PlanningWorker, record: Any, budget: float = 60.0) -> tuple[WorkerMessage | None, list[WorkerMessage]]:
    """What a planner answers, and what it answered late."""
    late: list[WorkerMessage] = []
    planner.reserve(budget)
    return planner.plan(job(record, budget=budget), hand(), lambda reply: None, late.append), late


def test_a_process_plans_again_and_again_and_ends_with_its_owner() -> None:
    planner = PlanningWorker()
    try:
        for kind in ("path", "fingers", "path"):
            said, late = planned(planner, write_move(moves()[kind]))
            assert said is not None
            assert not late
            record = decoded(said.reply)
            del record["sequence"], record["server_seconds"]
            assert_same_plan(read_answer(moves()[kind], record), decoded_move(moves()[kind]).plan())
        process = planner._process
        assert process is not None
        late = []
        planner.reserve(60.0)
        said = planner.plan(job(write_move(slow_move())), hand(), cancelling(planner), late.append)
        assert decoded((said or late[0]).reply)["plan"]["stopped"]
        assert process.poll() is None  # the same one all the time
    finally:
        planner.close()
    assert process.poll() is not None
    planner.cancel()  # nobody is there, and nothing happens
    planner.close()


@pytest.mark.parametrize(("command", "code"), [(DIES, "internal"), (("/nowhere/python",), "internal")])
def test_a_process_that_dies_is_an_error_and_the_next_plan_has_another(command: tuple[str, ...], code: str, caplog) -> None:  # type: ignore[no-untyped-def]
    planner = PlanningWorker(command)
    for _ in range(2):
        said, late = planned(planner, {})
        assert said is not None
        assert not late
        assert said.outcome == code
        assert decoded(said.reply)["sequence"] == 3
    assert "ended" in caplog.text


def test_a_process_that_dies_after_a_first_plan_leaves_it_as_the_answer() -> None:
    said, late = planned(PlanningWorker(DIES_WITH_A_PLAN), {})
    assert said is not None
    assert not late
    assert said.reply.payload == b"the best so far"


def test_a_process_that_does_not_end_in_time_is_ended_and_the_answer_does_not_wait_for_it(hasty: None) -> None:
    planner = PlanningWorker(HANGS)
    said, late = planned(planner, {}, budget=0.2)
    assert said is None
    assert len(late) == 1
    assert decoded(late[0].reply)["refusal"]["reason"] == "The budget of 0.2 s ended before there was a first plan."
    assert planner._process is None


def test_the_best_plan_so_far_is_what_a_process_that_hangs_is_good_for(hasty: None) -> None:
    planner = PlanningWorker(HANGS_WITH_A_PLAN)
    planner.reserve(PATIENCE)
    late: list[WorkerMessage] = []
    said = planner.plan(job({}), hand(), lambda reply: planner.cancel(), late.append)
    assert said is None
    assert [each.reply.payload for each in late] == [b"the best so far"]


def test_cancelled_before_it_was_even_sent_a_job_is_stopped_at_once() -> None:
    planner = PlanningWorker()
    planner.reserve(PATIENCE)
    planner.cancel()
    late: list[WorkerMessage] = []
    said = planner.plan(job(write_move(slow_move())), hand(), lambda reply: None, late.append)
    planner.close()
    assert decoded((said or late[0]).reply)["refusal"]["reason"] == "Planning was stopped before there was a first plan."


# ── many ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


class Puppet(PlanningWorker):
    """A planner whose work is done when a test says so, or when it is cancelled."""

    def __init__(self) -> None:
        super().__init__(())
        self.done = threading.Event()
        self.cancelled = self.closed = False
        self.jobs: list[PlanningJob] = []

    def reserve(self, budget: float) -> None:
        self.done.clear()

    def plan(
        self, job: PlanningJob, hand: Any, progress: Callable[[Reply], None], late: Callable[[WorkerMessage], None]
    ) -> WorkerMessage | None:
        self.jobs.append(job)
        progress(Reply(True, b"on the way", protocol.JSON))
        if job.record.get("late"):
            late(WorkerMessage(ANSWER, Reply(True, b"in time", protocol.JSON)))
            assert self.done.wait(PATIENCE)
            return None
        assert self.done.wait(PATIENCE)
        if job.record.get("fails"):
            raise ZeroDivisionError
        return WorkerMessage(ANSWER, Reply(True, job.id.encode(), protocol.JSON))

    def cancel(self) -> None:
        self.cancelled = True
        self.done.set()

    def close(self) -> None:
        self.closed = True


class Desk:
    """Plans with puppets, and what comes out of them."""

    def __init__(self, count: int = 2) -> None:
        self.puppets = [Puppet() for _ in range(count)]
        self.counts: Counter[tuple[str, str]] = Counter()
        self.published: list[str] = []
        self.plans = PlanRegistry(
            {HAND: hand()},
            workers=self.puppets,
            max_budget=60.0,
            max_intervals=500,
            publish=lambda id, reply: self.published.append(id),
            count=lambda key, outcome: self.counts.update([(key, outcome)]),
        )

    def ask(self, record: Any, codec: str | None = protocol.JSON) -> Asked:
        asked = Asked()
        payload = record if isinstance(record, bytes) else json.dumps(record).encode()
        self.plans.begin(KEY, payload, codec, asked)
        return asked


class Asked:
    """A request's replies."""

    def __init__(self) -> None:
        self.replies: list[Reply] = []
        self._came = threading.Event()

    def __call__(self, reply: Reply) -> None:
        self.replies.append(reply)
        self._came.set()

    def reply(self) -> Reply:
        assert self._came.wait(PATIENCE)
        (one,) = self.replies
        return one

    def error(self) -> dict[str, Any]:
        assert not self.reply().ok
        record: dict[str, Any] = decoded(self.reply())
        return record


def test_as_many_plans_as_there_are_planners_and_an_honest_word_to_others() -> None:
    desk = Desk()
    first, second = desk.ask({"id": "one"}), desk.ask({"id": "two"})
    third = desk.ask({"sequence": 9}).error()
    assert third == {"error": "overloaded", "message": third["message"], "field": None, "sequence": 9}
    assert third["message"] == "2 plans are active: no more are allowed; ask again when one has ended"
    assert len(desk.plans) == 2
    desk.plans.cancel("one")
    assert first.reply().payload == b"one"
    assert not second.replies
    again = desk.ask({"id": "three"})  # at once: who has its answer may ask again
    for puppet in desk.puppets:
        puppet.done.set()
    assert again.reply().payload == b"three"
    assert second.reply().payload == b"two"
    assert len(desk.plans) == 0
    assert desk.counts == {(KEY, "ok"): 3, (KEY, "overloaded"): 1}
    assert sorted(desk.published) == ["one", "three", "two"]


def test_a_process_that_still_tidies_up_is_waited_for_as_long_as_the_budget_and_nobody_cancels() -> None:
    desk = Desk(1)
    (puppet,) = desk.puppets
    assert desk.ask({"id": "one", "late": True}).reply().payload == b"in time"
    assert len(desk.plans) == 0
    refusal = decoded(desk.ask({"id": "short", "budget": 0.1}).reply())["refusal"]
    assert refusal["reason"] == "The budget of 0.1 s ended before there was a first plan."
    unwanted = desk.ask({"id": "unwanted"})
    desk.plans.cancel("unwanted")
    assert decoded(unwanted.reply())["refusal"]["reason"] == "Planning was stopped before there was a first plan."
    waiting = desk.ask({"id": "two"})
    assert desk.ask({"id": "three"}).error()["error"] == "overloaded"  # one at a time is begun, and one waits
    assert [job.id for job in puppet.jobs] == ["one"]
    puppet.done.set()
    while len(puppet.jobs) < 2 and not waiting.replies:
        time.sleep(0.01)
    puppet.done.set()
    assert waiting.reply().payload == b"two"


def test_an_id_is_one_plan_s_while_it_is_under_way() -> None:
    desk = Desk()
    first = desk.ask({"id": "one"})
    assert desk.ask({"id": "one"}).error()["field"] == "id"
    desk.plans.cancel("one")
    assert first.reply().ok
    again = desk.ask({"id": "one"})
    desk.plans.cancel("one")
    assert again.reply().ok


def test_what_is_not_under_way_can_be_cancelled_as_often_as_anybody_likes() -> None:
    desk = Desk(1)
    asked = desk.ask({"id": "one"})
    for id in ("two", "", "one/two", "x" * 10_000):
        desk.plans.cancel(id)
    assert not desk.puppets[0].cancelled
    for _ in range(20):
        desk.plans.cancel("one")
    assert asked.reply().ok
    assert len(asked.replies) == 1


def test_made_up_ids_differ_and_budgets_have_a_default_and_are_counted_from_receipt() -> None:
    desk = Desk()
    asked = [desk.ask({}), desk.ask({"budget": 5.0})]
    jobs = [puppet.jobs[0] for puppet in desk.puppets if puppet.jobs or puppet.done.wait(0.1) or puppet.jobs]
    desk.plans.close(time.monotonic() + PATIENCE)
    assert {each.reply().ok for each in asked} == {True}
    assert jobs[0].id != jobs[1].id
    assert {each.budget for each in jobs} == {8.0, 5.0}  # less than Zenoh's own ten
    for each in jobs:
        assert each.budget - PATIENCE < each.remaining < each.budget


@pytest.mark.parametrize(
    ("record", "code", "field"),
    [
        (b"", "invalid", "input"),
        (b"{", "invalid", "input"),
        ([1, 2], "invalid", None),
        (7, "invalid", None),
        ({"id": ""}, "invalid", "id"),
        ({"id": "a/b"}, "invalid", "id"),
        ({"id": "*"}, "invalid", "id"),
        ({"id": "x" * 65}, "invalid", "id"),
        ({"id": 5}, "invalid", "id"),
        ({"budget": 0.0}, "invalid", "budget"),
        ({"budget": 61.0}, "invalid", "budget"),
        ({"budget": "long"}, "invalid", "budget"),
        ({"intervals": 501}, "invalid", "intervals"),
        ({"intervals": 2.5}, "invalid", "intervals"),
        ({"backend": "ipopt"}, "invalid", "backend"),
        ({"sequence": -1}, "invalid", "sequence"),
        ({"method": "x" * 100_000}, "too_large", None),
    ],
)
def test_bad_requests_are_refused_before_any_process_sees_them(record: Any, code: str, field: str | None) -> None:
    desk = Desk()
    error = desk.ask(record).error()
    assert (error["error"], error["field"]) == (code, field)
    assert len(desk.plans) == 0
    assert desk.counts == {(KEY, code): 1}


def test_another_encoding_is_refused_in_json() -> None:
    assert Desk().ask({}, "text/plain").error()["field"] == "encoding"


def test_a_planner_that_fails_is_an_error_and_free_again(caplog) -> None:  # type: ignore[no-untyped-def]
    desk = Desk(1)
    for _ in range(3):
        asked = desk.ask({"id": "one", "fails": True})
        desk.plans.cancel("one")
        assert asked.error()["error"] == "internal"
    assert "ZeroDivisionError" in caplog.text


def test_at_the_end_all_are_cancelled_answered_and_ended_and_nobody_else_is_let_in() -> None:
    desk = Desk()
    asked = [desk.ask({}), desk.ask({})]
    desk.plans.close(time.monotonic() + PATIENCE)
    for each in asked:
        assert each.reply().ok
    assert all(puppet.closed for puppet in desk.puppets)
    assert desk.ask({}).error()["error"] == "overloaded"
