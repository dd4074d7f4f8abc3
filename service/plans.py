"""Plans under way, as the server keeps them: so many at once, each with an id by which it can be followed and cancelled.

No network here.
"""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from graspforce import fields
from graspforce.errors import InvalidInput, Refused
from graspforce.hand import Hand
from graspforce.service import wire
from graspforce.service.planner import GRACE, Planner
from graspforce.service.planning_process import ANSWER, Job, Message
from graspforce.service.reply import Reply, error_reply, what_went_wrong

_LARGEST = 96 * 2**10  # bytes of a move: with its hand it fits into a pipe that nobody reads yet


class Plans:
    """The plans under way. Safe to use from several threads.

    Args:
        hands: those that are served, by name.
        planners: as many plans at once.
        longest: the largest budget, s, and what a move gets that names none.
        finest: the most intervals of a plan.
        publish: called with a plan's id and how far it is.
        count: called with the key, the outcome and the seconds of each answer.
    """

    def __init__(
        self,
        hands: Mapping[str, Hand],
        *,
        planners: Sequence[Planner],
        longest: float,
        finest: int,
        publish: Callable[[str, Reply], None],
        count: Callable[[str, str, float], None],
    ) -> None:
        self._hands, self._publish, self._count = hands, publish, count
        self._longest, self._finest = longest, finest
        self._lock = threading.Lock()
        self._free, self._all = list(planners), len(planners)
        self._under_way: dict[str, tuple[Planner, threading.Thread]] = {}

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
            self._count(key, message.outcome, time.perf_counter() - received)
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
            planner, _ = self._under_way.get(id, (None, None))
            if planner is not None:
                planner.cancel()

    def stop(self) -> None:
        """Stop all, and begin no other: the answers are the best plans so far."""
        with self._lock:
            self._all = 0
            for planner, _ in self._under_way.values():
                planner.cancel()

    def close(self, deadline: float) -> None:
        """Stop all, wait for their answers, and end the processes.

        Args:
            deadline: until when to wait for processes, on the clock `time.monotonic`, s.
        """
        self.stop()
        with self._lock:
            under_way = list(self._under_way.values())
        for planner, thread in under_way:
            thread.join(max(min(deadline - time.monotonic(), 2.0 * GRACE), 0.0))
            planner.close()  # who has not been answered is, now
            thread.join(GRACE)
        for planner in self._free:
            planner.close()

    def _begin(self, hand: str, codec: str, request: Any, received: float, done: Callable[[Message], None]) -> None:
        envelope, record = wire.Envelope.split(request)
        if envelope.backend is not None:
            raise InvalidInput("backend", envelope.backend, "absent: each way of planning has its own solvers")
        if not isinstance(record, Mapping):
            raise InvalidInput("", request, "a record (a JSON object)")
        move = dict(record)
        id = move.pop("id", None)
        id = uuid.uuid4().hex if id is None else wire.plan_id(id)
        budget = self._longest if envelope.budget is None else envelope.budget
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
            if len(self._under_way) >= self._all:
                raise Refused("overloaded", f"{len(self._under_way)} plans are under way: ask again when one is done")
            planner = self._free.pop()
            thread = threading.Thread(target=self._run, args=(planner, job, done), name=f"plan-{id}", daemon=True)
            self._under_way[id] = (planner, thread)
            planner.claim(left)
        thread.start()

    def _run(self, planner: Planner, job: Job, done: Callable[[Message], None]) -> None:
        try:
            message = planner.plan(job, self._hands[job.hand], lambda reply: self._publish(job.id, reply), done)
        except Exception as error:
            outcome, words, field = what_went_wrong(error, f"hands/{job.hand}/plan")
            message = Message(ANSWER, error_reply(job.codec, outcome, words, field, job.sequence), outcome)
        with self._lock:  # before the answer: who has it may ask again at once
            del self._under_way[job.id]
            self._free.append(planner)
        if message is not None:
            done(message)
