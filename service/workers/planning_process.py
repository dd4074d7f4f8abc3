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
from dataclasses import replace
from multiprocessing.connection import Connection

import numpy as np

from graspforce.hand.hand import Hand
from graspforce.planning import PlanFailure, Progress
from graspforce.planning.failure import STOPPED
from graspforce.service.wire import protocol
from graspforce.service.wire.plan_records import read_move, write_progress
from graspforce.service.wire.reply import Reply, describe_error, make_error_reply
from graspforce.service.workers.jobs import (
    ANSWER,
    BEST_SO_FAR,
    PROGRESS,
    PlanningJob,
    WorkerMessage,
    make_plan_reply,
    make_stopped_failure,
)

_NICENESS = 10  # niceness: where processors are short, control goes first
_PROGRESS_PERIOD = 0.05  # s between messages of progress within a stage
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
)  # one each: what is small gains nothing from more


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
    stage, last_sent, plan = "", -np.inf, None

    def callback(now: Progress) -> bool:
        nonlocal stage, last_sent, plan
        if now.plan is not None and now.plan is not plan:
            plan = now.plan
            send(WorkerMessage(BEST_SO_FAR, make_plan_reply(job, replace(plan, stopped=True), began)))
        if now.stage != stage or now.seconds - last_sent >= _PROGRESS_PERIOD:
            stage, last_sent = now.stage, now.seconds
            send(WorkerMessage(PROGRESS, Reply(True, protocol.encode(write_progress(job.id, now), job.codec), job.codec)))
        return not cancelled()

    try:
        with np.errstate(all="ignore"):
            found = read_move(hand, job.record).plan(budget=job.remaining, callback=callback)
        if isinstance(found, PlanFailure) and found.kind == STOPPED:
            found = make_stopped_failure(job, cancelled())  # in words of the whole budget, not of what was left of it
        return WorkerMessage(ANSWER, make_plan_reply(job, found, began))
    except Exception as error:
        outcome, message, field = describe_error(error, f"hands/{job.hand_name}/plan")
        return WorkerMessage(ANSWER, make_error_reply(job.codec, outcome, message, field, job.sequence), outcome)


class HandCache:
    """The hands that a process has seen."""

    def __init__(self) -> None:
        self._hands: dict[str, Hand] = {}

    def get(self, job: PlanningJob) -> Hand:
        """The hand that a job names."""
        if job.hand_model is not None:
            self._hands[job.hand_name] = job.hand_model
        return self._hands[job.hand_name]


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
