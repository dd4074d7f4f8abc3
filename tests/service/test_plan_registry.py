"""Active plans, without a network: each request gets exactly one answer."""

from __future__ import annotations

import json
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
from support.plan_requests import HAND, hand

from graspforce.service import ServerLimits
from graspforce.service.server.deadline import Deadline
from graspforce.service.server.plan_registry import PlanRegistry
from graspforce.service.wire import protocol
from graspforce.service.wire.reply import Reply
from graspforce.service.workers.jobs import ANSWER, PlanningJob, WorkerMessage
from graspforce.service.workers.planning_worker import PlanningWorker

KEY = f"hands/{HAND}/plan"
TIMEOUT = 30.0  # s, enough for a busy machine; only a failing test waits so long


def decoded(reply: Reply) -> Any:
    return protocol.decode(reply.payload, reply.encoding)


class ControlledWorker(PlanningWorker):
    """A worker whose job ends when a test sets `done`, or when it is cancelled."""

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
        progress(Reply(True, b"progress", protocol.JSON))
        if job.record.get("late"):
            late(WorkerMessage(ANSWER, Reply(True, b"in time", protocol.JSON)))
            assert self.done.wait(TIMEOUT)
            return None
        assert self.done.wait(TIMEOUT)
        if job.record.get("fails"):
            raise ZeroDivisionError
        return WorkerMessage(ANSWER, Reply(True, job.id.encode(), protocol.JSON))

    def cancel(self) -> None:
        self.cancelled = True
        self.done.set()

    def close(self) -> None:
        self.closed = True


class RegistryWithWorkers:
    """A registry with controlled workers, and its outputs."""

    def __init__(self, count: int = 2, waiting: int = 0, client_plans: int = 100) -> None:
        self.workers = [ControlledWorker() for _ in range(count)]
        self.counts: Counter[tuple[str, str]] = Counter()
        self.published: list[str] = []
        self.plans = PlanRegistry(
            {HAND: hand()},
            workers=self.workers,
            limits=ServerLimits(waiting_plans=waiting, client_plans=client_plans),
            publish=lambda id, reply: self.published.append(id),
            count=lambda key, outcome: self.counts.update([(key, outcome)]),
        )

    def ask(self, record: Any, codec: str | None = protocol.JSON, client: bytes = b"") -> Replies:
        request = Replies()
        payload = record if isinstance(record, bytes) else json.dumps(record).encode()
        self.plans.begin(KEY, payload, codec, request, client=client)
        return request


class Replies:
    """The replies to one request."""

    def __init__(self) -> None:
        self.replies: list[Reply] = []
        self._arrived = threading.Event()

    def __call__(self, reply: Reply) -> None:
        self.replies.append(reply)
        self._arrived.set()

    def reply(self) -> Reply:
        assert self._arrived.wait(TIMEOUT)
        (one,) = self.replies
        return one

    def error(self) -> dict[str, Any]:
        assert not self.reply().ok
        record: dict[str, Any] = decoded(self.reply())
        return record


def test_there_are_as_many_active_plans_as_workers_and_more_are_refused() -> None:
    registry = RegistryWithWorkers()
    first, second = registry.ask({"id": "one"}), registry.ask({"id": "two"})
    third = registry.ask({"sequence": 9}).error()
    assert 0.0 < third.pop("retry_after") <= 8.0  # the default budget of a plan
    assert third == {"error": "overloaded", "message": third["message"], "field": None, "sequence": 9}
    assert third["message"] == "2 plans are active: no more are allowed; ask again when one has ended"
    assert len(registry.plans) == 2
    registry.plans.cancel("one")
    assert first.reply().payload == b"one"
    assert not second.replies
    again = registry.ask({"id": "three"})  # at once: an answered client may send its next request
    for worker in registry.workers:
        worker.done.set()
    assert again.reply().payload == b"three"
    assert second.reply().payload == b"two"
    assert len(registry.plans) == 0
    assert registry.counts == {(KEY, "ok"): 3, (KEY, "overloaded"): 1}
    assert sorted(registry.published) == ["one", "three", "two"]


def test_plan_waits_for_a_busy_worker_until_its_budget_ends_or_it_is_cancelled() -> None:
    registry = RegistryWithWorkers(1)
    (worker,) = registry.workers
    assert registry.ask({"id": "one", "late": True}).reply().payload == b"in time"
    assert len(registry.plans) == 0
    refusal = decoded(registry.ask({"id": "short", "budget": 0.1}).reply())["refusal"]
    assert refusal["reason"] == "The budget of 0.1 s ended before there was a first plan."
    unwanted = registry.ask({"id": "unwanted"})
    registry.plans.cancel("unwanted")
    assert decoded(unwanted.reply())["refusal"]["reason"] == "Planning was stopped before there was a first plan."
    waiting = registry.ask({"id": "two"})
    assert registry.ask({"id": "three"}).error()["error"] == "overloaded"  # the limit counts the plan that waits
    assert [job.id for job in worker.jobs] == ["one"]
    worker.done.set()
    while len(worker.jobs) < 2 and not waiting.replies:
        time.sleep(0.01)
    worker.done.set()
    assert waiting.reply().payload == b"two"


def test_id_belongs_to_one_active_plan() -> None:
    registry = RegistryWithWorkers()
    first = registry.ask({"id": "one"})
    assert registry.ask({"id": "one"}).error()["field"] == "id"
    registry.plans.cancel("one")
    assert first.reply().ok
    again = registry.ask({"id": "one"})
    registry.plans.cancel("one")
    assert again.reply().ok


def test_cancel_without_such_a_plan_does_nothing() -> None:
    registry = RegistryWithWorkers(1)
    request = registry.ask({"id": "one"})
    for id in ("two", "", "one/two", "x" * 10_000):
        registry.plans.cancel(id)
    assert not registry.workers[0].cancelled
    for _ in range(20):
        registry.plans.cancel("one")
    assert request.reply().ok
    assert len(request.replies) == 1


def test_ids_are_unique_and_budgets_have_a_default_and_count_from_receipt() -> None:
    registry = RegistryWithWorkers()
    request = [registry.ask({}), registry.ask({"budget": 5.0})]
    jobs = [worker.jobs[0] for worker in registry.workers if worker.jobs or worker.done.wait(0.1) or worker.jobs]
    registry.plans.close(Deadline(TIMEOUT))
    assert {each.reply().ok for each in request} == {True}
    assert jobs[0].id != jobs[1].id
    assert {each.budget for each in jobs} == {8.0, 5.0}  # less than the 10 s of Zenoh's queries
    for each in jobs:
        assert each.budget - TIMEOUT < each.remaining < each.budget


@pytest.mark.parametrize(
    ("record", "code", "field"),
    [
        (b"", "invalid", "input"),
        (b"{", "invalid", "input"),
        ([1, 2], "invalid", None),
        (7, "invalid", None),
        ({"id": ""}, "invalid", "id"),
        ({"id": "a/b/c"}, "invalid", "id"),
        ({"id": "/b"}, "invalid", "id"),
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
def test_invalid_requests_are_rejected_before_planning(record: Any, code: str, field: str | None) -> None:
    registry = RegistryWithWorkers()
    error = registry.ask(record).error()
    assert (error["error"], error["field"]) == (code, field)
    assert len(registry.plans) == 0
    assert registry.counts == {(KEY, code): 1}


def test_unknown_encoding_is_rejected_in_json() -> None:
    assert RegistryWithWorkers().ask({}, "text/plain").error()["field"] == "encoding"


def test_failing_worker_is_an_error_and_free_again(caplog) -> None:  # type: ignore[no-untyped-def]
    registry = RegistryWithWorkers(1)
    for _ in range(3):
        request = registry.ask({"id": "one", "fails": True})
        registry.plans.cancel("one")
        assert request.error()["error"] == "internal"
    assert "ZeroDivisionError" in caplog.text


def test_close_answers_all_plans_ends_all_workers_and_refuses_new_plans() -> None:
    registry = RegistryWithWorkers()
    request = [registry.ask({}), registry.ask({})]
    registry.plans.close(Deadline(TIMEOUT))
    for each in request:
        assert each.reply().ok
    assert all(worker.closed for worker in registry.workers)
    assert registry.ask({}).error()["error"] == "closing"


def test_clients_take_turns_at_the_workers() -> None:
    registry = RegistryWithWorkers(1, waiting=8)
    [worker] = registry.workers
    names = [("a0", b"a"), ("a1", b"a"), ("a2", b"a"), ("b0", b"b"), ("b1", b"b")]
    replies = []
    for i, (id, client) in enumerate(names):
        replies.append(registry.ask({"id": id}, client=client))
        wait_until(lambda count=i: len(registry.plans) == count + 1 and len(worker.jobs) == 1)
    for count in range(1, len(names) + 1):
        wait_until(lambda count=count: len(worker.jobs) == count)
        worker.done.set()
        wait_until(lambda count=count: len(registry.plans) == len(names) - count)
    assert [job.id for job in worker.jobs] == ["a0", "b0", "a1", "b1", "a2"]
    assert all(each.reply().ok for each in replies)


def test_client_has_a_quota_of_plans() -> None:
    registry = RegistryWithWorkers(2, waiting=8, client_plans=2)
    first = [registry.ask({}, client=b"a") for _ in range(2)]
    refused = registry.ask({}, client=b"a").error()
    assert refused["error"] == "overloaded"
    assert "of this client" in refused["message"]
    other = registry.ask({}, client=b"b")
    registry.plans.cancel_of(b"a")
    assert all(each.reply().ok for each in first)
    wait_until(lambda: len(registry.plans) == 1)
    registry.plans.cancel_of(b"b")
    assert other.reply().ok


def wait_until(is_met: Callable[[], object]) -> None:
    """Wait until a condition is met, or fail."""
    deadline = time.monotonic() + TIMEOUT
    while not is_met():
        assert time.monotonic() < deadline, "the condition was not met in time"
        time.sleep(0.002)
