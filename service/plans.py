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

from graspforce import fields
from graspforce.errors import InvalidInput, Refused
from graspforce.hand import Hand
from graspforce.service import wire
from graspforce.service.planner import GRACE, Planner
from graspforce.service.planning_process import ANSWER, Job, Message, nothing, reply
from graspforce.service.reply import Reply, error_reply, what_went_wrong

_UNASKED = 8.0  # s, the budget of a move that names none: by default Zenoh's queries wait for ten
_TURN = 0.05  # s between looks at whether a plan that waits is still wanted
_LARGEST = 96 * 2**10  # bytes of a move: with its hand it fits into a pipe that nobody reads yet


class Plans:
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
        planners: Sequence[Planner],
        longest: float,
        finest: int,
        publish: Callable[[str, Reply], None],
        count: Callable[[str, str], None],
    ) -> None:
        self._hands, self._publish, self._count = hands, publish, count
        self._longest, self._finest = longest, finest
        self._lock = threading.Lock()
        self._planners = tuple(planners)
        self._free: queue.SimpleQueue[Planner] = queue.SimpleQueue()
        for planner in planners:
            self._free.put(planner)
        self._under_way: dict[str, _UnderWay] = {}
        self._threads: set[threading.Thread] = set()
        self._closing = not planners

    def __len__(self) -> int:
        return len(self._under_way)

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
        codec, sequence = wire.JSON, None

        def done(message: Message) -> None:
            self._count(key, message.outcome)  # how long it took says nothing of the server: planning takes its budget
            answer(message.reply)

        try:
            codec = wire.codec(encoding)
            if len(payload) > _LARGEST:
                raise Refused("too_large", f"the move has {len(payload)} bytes: at most {_LARGEST} are allowed")
            request = wire.decode(payload, codec)
            sequence = wire.sequence_in(request)
            self._begin(key.split("/")[1], codec, request, received, done)
        except Exception as error:
            outcome, message, field = what_went_wrong(error, key)
            done(Message(ANSWER, error_reply(codec, outcome, message, field, sequence), outcome))

    def cancel(self, id: str) -> None:
        """Stop a plan; its answer is the best so far. To stop what is not under way does nothing."""
        with self._lock:
            if id in self._under_way:
                self._under_way[id].cancel()

    def stop(self) -> None:
        """Stop all, and begin no other: the answers are the best plans so far."""
        with self._lock:
            self._closing = True
            for plan in self._under_way.values():
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
            for planner in self._planners:
                planner.close()  # who has not been answered is, now

    def _begin(self, hand: str, codec: str, request: Any, received: float, done: Callable[[Message], None]) -> None:
        envelope, record = wire.Envelope.split(request)
        if envelope.backend is not None:
            raise InvalidInput("backend", envelope.backend, "absent: each way of planning has its own solvers")
        if not isinstance(record, Mapping):
            raise InvalidInput("", request, "a record (a JSON object)")
        move = dict(record)
        id = move.pop("id", None)
        id = uuid.uuid4().hex if id is None else wire.plan_id(id)
        budget = min(_UNASKED, self._longest) if envelope.budget is None else envelope.budget
        if budget > self._longest:
            raise InvalidInput("budget", budget, f"at most {self._longest:g} s")
        intervals = move.get("intervals")
        if intervals is not None:
            fields.whole(intervals, "intervals", minimum=2, maximum=self._finest)
        left = max(budget - (time.perf_counter() - received), 0.0)
        job = Job(id, hand, move, codec, envelope.sequence, budget, left)
        with self._lock:
            if id in self._under_way:
                raise InvalidInput("id", id, "an id that no other plan has while it is under way")
            if self._closing or len(self._under_way) >= len(self._planners):
                busy = f"{len(self._under_way)} plans are under way: ask again when one is done"
                raise Refused("overloaded", "this server makes no plans, or no more" if self._closing else busy)
            plan = self._under_way[id] = _UnderWay(job)
            thread = threading.Thread(target=self._run, args=(plan, done), name=f"plan-{id}", daemon=True)
            self._threads.add(thread)
        thread.start()

    def _run(self, plan: _UnderWay, done: Callable[[Message], None]) -> None:
        job = plan.job

        def answer(message: Message) -> None:
            with self._lock:  # before the answer: who has it may ask again at once
                if self._under_way.get(job.id) is not plan:
                    return  # it has one
                del self._under_way[job.id]
            done(message)

        planner = self._claimed(plan)
        message: Message | None = None
        try:
            if planner is None:
                message = Message(ANSWER, reply(job, nothing(job, plan.cancelled)))
            else:
                rest = replace(job, left=plan.left)
                message = planner.plan(rest, self._hands[job.hand], lambda said: self._publish(job.id, said), answer)
        except Exception as error:
            outcome, words, field = what_went_wrong(error, f"hands/{job.hand}/plan")
            message = Message(ANSWER, error_reply(job.codec, outcome, words, field, job.sequence), outcome)
        if planner is not None:
            self._free.put(planner)
        if message is not None:
            answer(message)
        with self._lock:
            self._threads.remove(threading.current_thread())

    def _claimed(self, plan: _UnderWay) -> Planner | None:
        """A planner that is free; one that has answered late may take a while to be. None where that is too long."""
        while True:
            with contextlib.suppress(queue.Empty):
                planner = self._free.get(timeout=min(_TURN, plan.left))
                with self._lock:
                    plan.planner = planner
                    planner.claim(plan.left)
                    if plan.cancelled:
                        planner.cancel()
                return planner
            if plan.cancelled or plan.left <= 0.0:
                return None


class _UnderWay:
    """A plan that has not been answered.

    Attributes:
        job: the move.
        planner: who plans it; None as long as nobody does.
        cancelled: whether it was cancelled.
    """

    def __init__(self, job: Job) -> None:
        self.job, self.cancelled = job, False
        self.planner: Planner | None = None
        self._end = time.monotonic() + job.left

    @property
    def left(self) -> float:
        """Of its budget, s."""
        return max(self._end - time.monotonic(), 0.0)

    def cancel(self) -> None:
        """Stop it, now or when it begins."""
        self.cancelled = True
        if self.planner is not None:
            self.planner.cancel()
