"""The program of a planning process: it receives jobs, sends progress, and answers with encoded records.

Planning occupies a processor for seconds, much of it in Python. In the server's own process it would delay control streams. A
process of its own has a lower priority, keeps the equations of each hand between jobs, and can be killed.
"""

from __future__ import annotations

import select
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection

import numpy as np

from graspforce.core.errors import InvalidInput
from graspforce.grasp.search import GraspSearchProgress, RankedGrasp, find_grasps, measure_grasp, relax_idle_fingers
from graspforce.hand.hand import Hand
from graspforce.planning import PlanFailure, Progress, move_from_dict
from graspforce.planning.failure import STOPPED
from graspforce.planning.progress import SEARCH
from graspforce.planning.regrasp import RegraspProgress, plan_regrasp_to
from graspforce.service.wire import protocol
from graspforce.service.wire.grasp_records import GraspRequest
from graspforce.service.wire.plan_records import write_progress
from graspforce.service.wire.regrasp_records import RegraspRequest
from graspforce.service.wire.reply import Reply, make_failure_reply
from graspforce.service.workers.jobs import (
    ANSWER,
    BEST_SO_FAR,
    GRASP,
    PROGRESS,
    REGRASP,
    PlanningJob,
    WorkerMessage,
    make_grasp_reply,
    make_plan_reply,
    make_regrasp_reply,
    make_stopped_answer,
    make_stopped_failure,
)

_PROGRESS_PERIOD = 0.05  # s, between progress messages within a stage


def run_job(
    job: PlanningJob, hand: Hand, send: Callable[[WorkerMessage], None], cancelled: Callable[[], bool]
) -> WorkerMessage:
    """Plan a move or a regrasp, or find a grasp, and return the answer. Every exception becomes an error record.

    Args:
        job: the move, or the request for a regrasp or a grasp.
        hand: its hand.
        send: called with progress messages, and with each better plan.
        cancelled: called at each stage and iteration; return True to stop.
    """
    try:
        with np.errstate(all="ignore"):
            if job.task == GRASP:
                return _find_grasp(job, hand, cancelled)
            return (_plan_regrasp if job.task == REGRASP else _plan_move)(job, hand, send, cancelled)
    except Exception as error:
        outcome, reply = make_failure_reply(job.codec, error, job.key, job.sequence)
        return WorkerMessage(ANSWER, reply, outcome)


def _find_grasp(job: PlanningJob, hand: Hand, cancelled: Callable[[], bool]) -> WorkerMessage:
    """Find grasps and return the answer."""
    began = time.perf_counter()
    request = GraspRequest.from_dict(job.record)
    if job.remaining <= 0.0:
        return make_stopped_answer(job, cancelled=False)
    is_cancelled = False

    def callback(progress: GraspSearchProgress) -> bool:
        nonlocal is_cancelled
        is_cancelled = cancelled()
        return not is_cancelled

    options = replace(request.options, budget=job.remaining, callback=callback)
    try:
        found = find_grasps(
            hand,
            request.body,
            request.count,
            request.fingers,
            rank=request.rank,
            friction=request.friction,
            gravity_H=request.gravity,
            seed=request.seed,
            options=options,
            callback=lambda searches, found: not is_cancelled,
        )
    except InvalidInput as error:
        if is_cancelled or time.perf_counter() - began >= job.remaining:
            return make_stopped_answer(job, is_cancelled, str(error))
        raise
    relaxed = [relax_idle_fingers(each.grasp) for each in found]
    measured = [RankedGrasp(grasp, measure_grasp(grasp), each.seed) for grasp, each in zip(relaxed, found, strict=True)]
    measured.sort(key=lambda each: -each.measures.value(request.rank))
    return WorkerMessage(ANSWER, make_grasp_reply(job, measured, began))


def _plan_move(
    job: PlanningJob, hand: Hand, send: Callable[[WorkerMessage], None], cancelled: Callable[[], bool]
) -> WorkerMessage:
    """Plan a move and return the answer."""
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

    result = move_from_dict(job.record, hand).plan(budget=job.remaining, callback=callback)
    if isinstance(result, PlanFailure) and result.kind == STOPPED:
        result = make_stopped_failure(job, cancelled())  # its message names the whole budget, not the remaining part
    return WorkerMessage(ANSWER, make_plan_reply(job, result, began))


def _plan_regrasp(
    job: PlanningJob, hand: Hand, send: Callable[[WorkerMessage], None], cancelled: Callable[[], bool]
) -> WorkerMessage:
    """Plan a regrasp and return the answer."""
    began = time.perf_counter()
    request = RegraspRequest.from_dict(hand, job.record)
    if job.remaining <= 0.0:
        return make_stopped_answer(job, cancelled=False)
    last_sent, farthest, is_cancelled = -np.inf, 0.0, False

    def callback(now: RegraspProgress) -> bool:
        nonlocal last_sent, farthest, is_cancelled
        farthest, seconds = max(farthest, now.u / now.length), time.perf_counter() - began
        if seconds - last_sent >= _PROGRESS_PERIOD:
            last_sent = seconds
            record = write_progress(job.id, Progress(SEARCH, farthest, now.tried, None, seconds))
            send(WorkerMessage(PROGRESS, Reply(True, protocol.encode(record, job.codec), job.codec)))
        is_cancelled = cancelled()
        return not is_cancelled

    result = plan_regrasp_to(request.goal, replace(request.search, budget=job.remaining), callback)
    if is_cancelled:
        return make_stopped_answer(job, cancelled=True)
    return WorkerMessage(ANSWER, make_regrasp_reply(job, result, began))


class HandCache:
    """The hands that this process has received, by name."""

    def __init__(self) -> None:
        self._hands: dict[str, Hand] = {}

    def get(self, job: PlanningJob) -> Hand:
        """Return the hand of a job, and store it if the job brings it.

        Args:
            job: the job; the first one for each hand has its `hand_model`.
        """
        if job.hand_model is not None:
            self._hands[job.hand_name] = job.hand_model
        return self._hands[job.hand_name]


def limit_memory(size: int) -> None:
    """Limit the memory of this process.

    Args:
        size: largest address space, bytes; 0 for no limit.
    """
    try:
        import resource
    except ImportError:  # not on Windows
        return
    if size > 0:
        resource.setrlimit(resource.RLIMIT_AS, (size, size))


def main() -> None:
    """Run the jobs that arrive through a pipe until it is closed.

    The last command-line arguments are the memory limit in bytes and the number of the pipe.
    """
    *_, memory, number = sys.argv
    limit_memory(int(memory))
    pipe = Connection(int(number))
    hands = HandCache()

    def cancelled() -> bool:
        """Return True if a message has arrived: during a job it is a cancel, or the end of the server."""
        return bool(select.select([pipe], [], [], 0.0)[0])

    try:
        while True:
            job = pipe.recv()
            if isinstance(job, PlanningJob):  # ignore a cancel that arrives after its plan is done
                pipe.send(run_job(job, hands.get(job), pipe.send, cancelled))
    except (EOFError, OSError, KeyboardInterrupt):
        return  # the server has ended
