"""Messages between the server and a planning process, and the replies that they carry."""

from __future__ import annotations

import time
from dataclasses import dataclass

from graspforce.hand.hand import Hand
from graspforce.planning import Plan, PlanFailure
from graspforce.planning.progress import stopped_failure
from graspforce.service.wire import protocol
from graspforce.service.wire.plan_records import write_answer
from graspforce.service.wire.reply import Reply

PROGRESS, BEST_SO_FAR, ANSWER = "progress", "so far", "answer"  # kinds of WorkerMessage
CANCEL = "cancel"  # message from the server: stop the current job


@dataclass(frozen=True, eq=False, slots=True)
class PlanningJob:
    """A move to plan.

    Args:
        id: id of the plan.
        hand_name: name of the hand.
        record: the move as a plain record.
        codec: codec of all messages about the plan.
        sequence: sequence number of the request, or None.
        budget: time for planning that the client allows, s.
        remaining: part of the budget that remains, s.
        hand_model: the hand, if this process has not received it before.
    """

    id: str
    hand_name: str
    record: object
    codec: str
    sequence: int | None
    budget: float
    remaining: float
    hand_model: Hand | None = None

    @property
    def elapsed(self) -> float:
        """Part of the budget that passed before planning began, s."""
        return self.budget - self.remaining


@dataclass(frozen=True, slots=True)
class WorkerMessage:
    """A message of a planning process.

    Args:
        kind: `PROGRESS`, `BEST_SO_FAR` (the reply if the budget ends) or `ANSWER`.
        reply: the encoded record.
        outcome: "ok" or an error code.
    """

    kind: str
    reply: Reply
    outcome: str = "ok"


def make_plan_reply(job: PlanningJob, result: Plan | PlanFailure, began: float | None = None) -> Reply:
    """Return the reply with a plan or a failure.

    Args:
        job: the job.
        result: the plan, or the failure.
        began: when planning began, on the clock `time.perf_counter`, s; None if the whole budget is spent.
    """
    seconds = job.budget if began is None else job.elapsed + time.perf_counter() - began
    record = {**write_answer(job.id, result), "server_seconds": seconds}
    if job.sequence is not None:
        record["sequence"] = job.sequence
    return Reply(True, protocol.encode(record, job.codec), job.codec)


def make_stopped_failure(job: PlanningJob, cancelled: bool) -> PlanFailure:
    """Return the failure of a job that ended before its first plan.

    Args:
        job: the job.
        cancelled: True if a client stopped it, False if its budget ended.
    """
    return stopped_failure(None if cancelled else job.budget)
