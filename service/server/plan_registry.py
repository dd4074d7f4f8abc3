"""Plans under way, as the server keeps them: so many at once, each with an id by which it can be followed and cancelled.

No network here.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from graspforce.core import fields
from graspforce.core.errors import InvalidInput, RequestRefused
from graspforce.hand.hand import Hand
from graspforce.service.wire import protocol
from graspforce.service.wire.reply import Reply, describe_error, make_error_reply
from graspforce.service.workers.jobs import ANSWER, PlanningJob, WorkerMessage, make_plan_reply, make_stopped_failure
from graspforce.service.workers.planning_worker import GRACE, PlanningWorker

_DEFAULT_BUDGET = 8.0  # s, the budget of a move that names none: by default Zenoh's queries wait for ten
_POLL_PERIOD = 0.05  # s between looks at whether a plan that waits is still wanted
_MAX_MOVE_BYTES = 96 * 2**10  # bytes of a move: with its hand it fits into a pipe that nobody reads yet


class PlanRegistry:
    """The plans under way. Safe to use from several threads.

    Args:
        hands: those that are served, by name.
        planners: as many plans at once.
        longest: the largest budget, s.
        finest: the most intervals of a plan.
        publish: called with a plan's id and how far it is.
        count: called with the key and the outcome of each answer.
    """

    def __init__(
        self,
        hands: Mapping[str, Hand],
        *,
        workers: Sequence[PlanningWorker],
        max_budget: float,
        max_intervals: int,
        publish: Callable[[str, Reply], None],
        count: Callable[[str, str], None],
    ) -> None:
        self._hands, self._publish, self._count = hands, publish, count
        self._max_budget, self._max_intervals = max_budget, max_intervals
        self._lock = threading.Lock()
        self._workers = tuple(workers)
        self._free_workers: queue.SimpleQueue[PlanningWorker] = queue.SimpleQueue()
        for worker in workers:
            self._free_workers.put(worker)
        self._active: dict[str, _ActivePlan] = {}
        self._threads: set[threading.Thread] = set()
        self._closing = not workers

    def __len__(self) -> int:
        return len(self._active)

    def begin(
        self, key: str, payload: bytes, encoding: str | None, answer: Callable[[Reply], None], received: float | None = None
    ) -> None:
        """Begin to plan a move, whatever the request holds; returns at once. Answered once, from whichever thread.

        Args:
            key: what was asked, below the prefix: ``hands/<hand>/plan``.
            payload: the request.
            encoding: its Zenoh encoding; None for JSON.
            answer: called with the reply.
            received: when it came, on the clock `time.perf_counter`; None for now.
        """
        received = time.perf_counter() if received is None else received
        codec, sequence = protocol.JSON, None

        def done(message: WorkerMessage) -> None:
            self._count(key, message.outcome)  # how long it took says nothing of the server: planning takes its budget
            answer(message.reply)

        try:
            codec = protocol.select_codec(encoding)
            if len(payload) > _MAX_MOVE_BYTES:
                raise RequestRefused("too_large", f"the move has {len(payload)} bytes: at most {_MAX_MOVE_BYTES} are allowed")
            request = protocol.decode(payload, codec)
            sequence = protocol.find_sequence(request)
            self._begin(key.split("/")[1], codec, request, received, done)
        except Exception as error:
            outcome, message, field = describe_error(error, key)
            done(WorkerMessage(ANSWER, make_error_reply(codec, outcome, message, field, sequence), outcome))

    def cancel(self, id: str) -> None:
        """Stop a plan; its answer is the best so far. To stop what is not under way does nothing."""
        with self._lock:
            if id in self._active:
                self._active[id].cancel()

    def stop(self) -> None:
        """Stop all, and begin no other: the answers are the best plans so far."""
        with self._lock:
            self._closing = True
            for plan in self._active.values():
                plan.cancel()

    def close(self, deadline: float) -> None:
        """Stop all, wait for their answers, and end the processes.

        Args:
            deadline: until when to wait for processes, on the clock `time.monotonic`, s.
        """
        self.stop()
        deadline = min(deadline, time.monotonic() + 2.0 * GRACE)
        for wait in (True, False):
            for thread in list(self._threads):
                thread.join(max(deadline - time.monotonic(), 0.0) if wait else GRACE)
            for worker in self._workers:
                worker.close()  # who has not been answered is, now

    def _begin(self, hand: str, codec: str, request: Any, received: float, done: Callable[[WorkerMessage], None]) -> None:
        envelope, record = protocol.Envelope.split(request)
        if envelope.backend is not None:
            raise InvalidInput("backend", envelope.backend, "absent: each way of planning has its own solvers")
        if not isinstance(record, Mapping):
            raise InvalidInput("", request, "a record (a JSON object)")
        move = dict(record)
        id = move.pop("id", None)
        id = uuid.uuid4().hex if id is None else protocol.check_plan_id(id)
        budget = min(_DEFAULT_BUDGET, self._max_budget) if envelope.budget is None else envelope.budget
        if budget > self._max_budget:
            raise InvalidInput("budget", budget, f"at most {self._max_budget:g} s")
        intervals = move.get("intervals")
        if intervals is not None:
            fields.check_integer(intervals, "intervals", minimum=2, maximum=self._max_intervals)
        remaining = max(budget - (time.perf_counter() - received), 0.0)
        job = PlanningJob(id, hand, move, codec, envelope.sequence, budget, remaining)
        with self._lock:
            if id in self._active:
                raise InvalidInput("id", id, "an id that no other plan has while it is under way")
            if self._closing or len(self._active) >= len(self._workers):
                busy = f"{len(self._active)} plans are under way: ask again when one is done"
                raise RequestRefused("overloaded", "this server makes no plans, or no more" if self._closing else busy)
            plan = self._active[id] = _ActivePlan(job)
            thread = threading.Thread(target=self._run, args=(plan, done), name=f"plan-{id}", daemon=True)
            self._threads.add(thread)
        thread.start()

    def _run(self, plan: _ActivePlan, done: Callable[[WorkerMessage], None]) -> None:
        job = plan.job

        def answer(message: WorkerMessage) -> None:
            with self._lock:  # before the answer: who has it may ask again at once
                if self._active.get(job.id) is not plan:
                    return  # it has one
                del self._active[job.id]
            done(message)

        worker = self._wait_for_worker(plan)
        message: WorkerMessage | None = None
        try:
            if worker is None:
                message = WorkerMessage(ANSWER, make_plan_reply(job, make_stopped_failure(job, plan.cancelled)))
            else:
                rest = replace(job, remaining=plan.remaining)
                message = worker.plan(rest, self._hands[job.hand_name], lambda said: self._publish(job.id, said), answer)
        except Exception as error:
            outcome, words, field = describe_error(error, f"hands/{job.hand_name}/plan")
            message = WorkerMessage(ANSWER, make_error_reply(job.codec, outcome, words, field, job.sequence), outcome)
        if worker is not None:
            self._free_workers.put(worker)
        if message is not None:
            answer(message)
        with self._lock:
            self._threads.remove(threading.current_thread())

    def _wait_for_worker(self, plan: _ActivePlan) -> PlanningWorker | None:
        """A planner that is free; one that has answered late may take a while to be. None where that is too long."""
        while True:
            with contextlib.suppress(queue.Empty):
                worker = self._free_workers.get(timeout=min(_POLL_PERIOD, plan.remaining))
                with self._lock:
                    plan.worker = worker
                    worker.reserve(plan.remaining)
                    if plan.cancelled:
                        worker.cancel()
                return worker
            if plan.cancelled or plan.remaining <= 0.0:
                return None


class _ActivePlan:
    """A plan that has not been answered.

    Attributes:
        job: the move.
        planner: who plans it; None as long as nobody does.
        cancelled: whether it was cancelled.
    """

    def __init__(self, job: PlanningJob) -> None:
        self.job, self.cancelled = job, False
        self.worker: PlanningWorker | None = None
        self._deadline = time.monotonic() + job.remaining

    @property
    def remaining(self) -> float:
        """Of its budget, s."""
        return max(self._deadline - time.monotonic(), 0.0)

    def cancel(self) -> None:
        """Stop it, now or when it begins."""
        self.cancelled = True
        if self.worker is not None:
            self.worker.cancel()
