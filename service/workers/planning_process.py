"""A process that plans: it waits for moves, says how far it is, and answers in the bytes that the network carries.

Planning keeps a processor busy for seconds, and much of it is Python's: in the server's own process, control streams would wait
for it. Here it is in nobody's way, gives way to them (`_NICENESS`), keeps what it has built of each hand, and may be ended.
"""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from graspforce.hand.hand import Hand
from graspforce.planning import Plan, PlanFailure, Progress
from graspforce.planning.failure import STOPPED
from graspforce.service.wire import protocol
from graspforce.service.wire.plan_records import read_move, write_answer, write_progress
from graspforce.service.wire.reply import Reply, describe_error, make_error_reply

_NICENESS = 10  # niceness: where processors are short, control goes first
_PROGRESS_PERIOD = 0.05  # s between messages of progress within a stage
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
)  # one each: what is small gains nothing from more

CANCEL = "cancel"


@dataclass(frozen=True, eq=False, slots=True)
class PlanningJob:
    """A move to plan.

    Args:
        id: the plan's.
        hand: the hand's name.
        record: the move, as plain values.
        codec: of all that is sent about it.
        sequence: the caller's number, or None.
        budget: s, as asked.
        left: what is left of it, s.
        known: the hand itself, where this process has not seen it.
    """

    id: str
    hand: str
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


PROGRESS, BEST_SO_FAR, ANSWER = "progress", "so far", "answer"


def run_job(
    job: PlanningJob, hand: Hand, send: Callable[[WorkerMessage], None], cancelled: Callable[[], bool]
) -> WorkerMessage:
    """Plan a move, whatever it says: every error becomes an error record.

    Args:
        job: the move.
        hand: the hand that it names.
        tell: called with how far it is, and with every better plan.
        cancelled: asked at every stage and iteration.
    """
    began = time.perf_counter()
    stage, told, plan = "", -np.inf, None

    def callback(now: Progress) -> bool:
        nonlocal stage, told, plan
        if now.plan is not None and now.plan is not plan:
            plan = now.plan
            send(WorkerMessage(BEST_SO_FAR, reply(job, replace(plan, stopped=True), began)))
        if now.stage != stage or now.seconds - told >= _PROGRESS_PERIOD:
            stage, told = now.stage, now.seconds
            send(WorkerMessage(PROGRESS, Reply(True, protocol.encode(write_progress(job.id, now), job.codec), job.codec)))
        return not cancelled()

    try:
        with np.errstate(all="ignore"):
            found = read_move(hand, job.record).plan(budget=job.remaining, callback=callback)
        if isinstance(found, PlanFailure) and found.kind == STOPPED:
            found = make_stopped_failure(job, cancelled())  # in words of the whole budget, not of what was left of it
        return WorkerMessage(ANSWER, reply(job, found, began))
    except Exception as error:
        outcome, message, field = describe_error(error, f"hands/{job.hand}/plan")
        return WorkerMessage(ANSWER, make_error_reply(job.codec, outcome, message, field, job.sequence), outcome)


def reply(job: PlanningJob, found: Plan | PlanFailure, began: float | None = None) -> Reply:
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


def make_stopped_failure(job: PlanningJob, told: bool) -> PlanFailure:
    """That there is no plan so far: whether it was told to stop, or out of time."""
    ended = "Planning was stopped" if told else f"The budget of {job.budget:g} s ended"
    return PlanFailure(STOPPED, f"{ended} before there was a first plan.")


class HandCache:
    """The hands that a process has seen."""

    def __init__(self) -> None:
        self._hands: dict[str, Hand] = {}

    def get(self, job: PlanningJob) -> Hand:
        """The hand that a job names."""
        if job.hand_model is not None:
            self._hands[job.hand] = job.hand_model
        return self._hands[job.hand]


def worker_environment() -> dict[str, str]:
    """What a planning process is started with."""
    return {**os.environ, **dict.fromkeys(_THREAD_VARIABLES, "1")}


def main() -> None:
    """Plan what comes through the pipe whose number is the process's last argument, until it is closed."""
    pipe = Connection(int(sys.argv[-1]))
    if hasattr(os, "nice"):
        os.nice(_NICENESS)
    hands = HandCache()

    def cancelled() -> bool:
        """Whether anything has come: while a plan is worked out that is a cancel, or the end of the server."""
        return bool(select.select([pipe], [], [], 0.0)[0])

    try:
        while True:
            job = pipe.recv()
            if isinstance(job, PlanningJob):  # a cancel may come when its plan is done
                pipe.send(run_job(job, hands.get(job), pipe.send, cancelled))
    except (EOFError, OSError, KeyboardInterrupt):
        return  # the server has ended
