"""Messages between the server and a planning process."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from graspforce.hand.hand import Hand
from graspforce.planning import Plan, PlanFailure
from graspforce.planning.failure import STOPPED
from graspforce.service.wire import protocol
from graspforce.service.wire.plan_records import write_answer
from graspforce.service.wire.reply import Reply

PROGRESS, BEST_SO_FAR, ANSWER = "progress", "so far", "answer"  # kinds of WorkerMessage
CANCEL = "cancel"


@dataclass(frozen=True, eq=False, slots=True)
class PlanningJob:
    """A move to plan.

    Args:
        id: the plan's.
        hand_name: the name of the hand.
        record: the move, as plain values.
        codec: of all that is sent about it.
        sequence: the caller's number, or None.
        budget: s, as asked.
        left: what is left of it, s.
        known: the hand itself, where this process has not seen it.
    """

    id: str
    hand_name: str
    record: Any
    codec: str
    sequence: int | None
    budget: float
    remaining: float
    hand_model: Hand | None = None

    @property
    def elapsed(self) -> float:
        """What of its budget had passed before it was begun, s."""
        return self.budget - self.remaining


@dataclass(frozen=True, slots=True)
class WorkerMessage:
    """What a planning process says: how far it is, the reply that would do if there is no other, or the reply.

    Args:
        kind: `PROGRESS`, `BEST_SO_FAR` or `ANSWER`.
        reply: the bytes.
        outcome: "ok", or an error's code.
    """

    kind: str
    reply: Reply
    outcome: str = "ok"


def make_plan_reply(job: PlanningJob, found: Plan | PlanFailure, began: float | None = None) -> Reply:
    """The reply that says what was found.

    Args:
        job: what was asked.
        found: the plan, or why there is none.
        began: when work began, on the clock `time.perf_counter`; None where all of the budget is spent.
    """
    seconds = job.budget if began is None else job.elapsed + time.perf_counter() - began
    record = {**write_answer(job.id, found), "server_seconds": seconds}
    if job.sequence is not None:
        record["sequence"] = job.sequence
    return Reply(True, protocol.encode(record, job.codec), job.codec)


def make_stopped_failure(job: PlanningJob, cancelled: bool) -> PlanFailure:
    """That there is no plan so far: whether it was cancelled to stop, or out of time."""
    ended = "Planning was stopped" if cancelled else f"The budget of {job.budget:g} s ended"
    return PlanFailure(STOPPED, f"{ended} before there was a first plan.")
