"""Messages between the server and a planning process, and the replies that they carry.

Jobs are moves, regrasps and grasp searches.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from graspforce.core.json_text import JsonRecord
from graspforce.grasp.search import RankedGrasp
from graspforce.hand.hand import Hand
from graspforce.planning import Plan, PlanFailure
from graspforce.planning.progress import stopped_failure
from graspforce.planning.regrasp import RegraspPlan
from graspforce.service.wire import protocol
from graspforce.service.wire.grasp_records import write_grasps
from graspforce.service.wire.plan_records import write_answer
from graspforce.service.wire.regrasp_records import write_regrasp
from graspforce.service.wire.reply import Reply, make_error_reply

PROGRESS, BEST_SO_FAR, ANSWER = "progress", "so far", "answer"  # kinds of WorkerMessage
PLAN, GRASP, REGRASP = "plan", "grasp", "regrasp"  # tasks of PlanningJob, and the last parts of their keys
TASKS = (PLAN, GRASP, REGRASP)
CANCEL = "cancel"  # message from the server: stop the current job


@dataclass(frozen=True, eq=False, slots=True)
class PlanningJob:
    """A move or a regrasp to plan, or an object to find a grasp for.

    Args:
        id: id of the plan.
        hand_name: name of the hand.
        record: the move, the `RegraspRequest` or the `GraspRequest` as a plain record.
        codec: codec of all messages about the job.
        sequence: sequence number of the request, or None.
        budget: time for the job that the client allows, s.
        remaining: part of the budget that remains, s.
        hand_model: the hand, if this process has not received it before.
        task: one of `TASKS`.
    """

    id: str
    hand_name: str
    record: object
    codec: str
    sequence: int | None
    budget: float
    remaining: float
    hand_model: Hand | None = None
    task: str = PLAN

    @property
    def key(self) -> str:
        """Key of the request after the prefix."""
        return f"hands/{self.hand_name}/{self.task}"

    @property
    def elapsed(self) -> float:
        """Part of the budget that passed before the work began, s."""
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
    return _make_reply(job, write_answer(job.id, result), began)


def make_regrasp_reply(job: PlanningJob, result: RegraspPlan | PlanFailure, began: float | None = None) -> Reply:
    """Return the reply with a plan of a regrasp or a failure.

    Args:
        job: the job.
        result: the plan, or the failure.
        began: as in `make_plan_reply`.
    """
    return _make_reply(job, write_regrasp(job.id, result), began)


def make_grasp_reply(job: PlanningJob, found: Sequence[RankedGrasp], began: float) -> Reply:
    """Return the reply with grasps.

    Args:
        job: the job.
        found: the grasps, the best first.
        began: when the search began, on the clock `time.perf_counter`, s.
    """
    return _make_reply(job, {"id": job.id, **write_grasps(found)}, began)


def make_stopped_failure(job: PlanningJob, cancelled: bool) -> PlanFailure:
    """Return the failure of a job that ended before its first plan.

    Args:
        job: the job.
        cancelled: True if a client stopped it, False if its budget ended.
    """
    return stopped_failure(None if cancelled else job.budget)


def make_stopped_answer(job: PlanningJob, cancelled: bool, fault: str = "") -> WorkerMessage:
    """Return the answer to a job that ended without a result.

    Args:
        job: the job.
        cancelled: True if a client stopped it, False if its budget ended.
        fault: what the best result lacks, if any is known.
    """
    if job.task != GRASP:
        make_reply = make_plan_reply if job.task == PLAN else make_regrasp_reply
        return WorkerMessage(ANSWER, make_reply(job, make_stopped_failure(job, cancelled)))
    reason = "the search was cancelled" if cancelled else f"budget of {job.budget:.6g} s exceeded"
    text = f"{reason}: no grasp was found" + (f"; {fault}" if fault else "")
    return WorkerMessage(ANSWER, make_error_reply(job.codec, "deadline", text, None, job.sequence), "deadline")


def _make_reply(job: PlanningJob, record: JsonRecord, began: float | None) -> Reply:
    """Return the reply with a record, the time that it took, and the sequence number of its request."""
    seconds = job.budget if began is None else job.elapsed + time.perf_counter() - began
    record = {**record, "server_seconds": seconds}
    if job.sequence is not None:
        record["sequence"] = job.sequence
    return Reply(True, protocol.encode(record, job.codec), job.codec)
