"""A planning process as the server sees it: started when first asked, kept warm, told to stop, and ended if it does not."""

from __future__ import annotations

import contextlib
import logging
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from graspforce.hand.hand import Hand
from graspforce.service.wire.reply import Reply, make_error_reply
from graspforce.service.workers.jobs import (
    ANSWER,
    CANCEL,
    PROGRESS,
    PlanningJob,
    WorkerMessage,
    make_plan_reply,
    make_stopped_failure,
)
from graspforce.service.workers.planning_process import worker_environment

log = logging.getLogger("graspforce.service")

GRACE = 0.5  # s beyond its budget, or after a cancel, that a process has to answer; then the best plan so far is the answer
_STUCK = 20.0  # s that it may go on after that: what it builds of a hand on the way is worth keeping
_POLL_PERIOD = 0.05  # s between looks at the clock
_START = "from graspforce.service.workers.planning_process import main; main()"


class PlanningWorker:
    """One planning process. One thread at a time gives it jobs; any thread may cancel.

    Args:
        command: what is started in place of a planning process.
    """

    def __init__(self, command: tuple[str, ...] = (sys.executable, "-c", _START)) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Connection | None = None
        self._sent_hands: set[str] = set()
        self._lock = threading.Lock()
        self._deadline = 0.0  # on the clock `time.monotonic`, s: when the answer must have gone out
        self._reserved = self._job_sent = self._cancelled = False

    def reserve(self, budget: float) -> None:
        """The next job is one's own, and may be cancelled from now on.

        Args:
            budget: s that it may take from now.
        """
        with self._lock:
            self._deadline, self._reserved, self._job_sent, self._cancelled = (
                time.monotonic() + budget + GRACE,
                True,
                False,
                False,
            )

    def plan(
        self, job: PlanningJob, hand: Hand, progress: Callable[[Reply], None], on_timeout: Callable[[WorkerMessage], None]
    ) -> WorkerMessage | None:
        """The answer to the job that was claimed.

        Where the process has none by the end of the budget and the grace, the best plan so far is the answer, or that there is
        none: ``late`` is called with it, and this returns None when the process is free again, or has been ended.

        Args:
            job: the move.
            hand: the hand that it names.
            progress: called with how far it is.
            late: called at most once.
        """
        so_far: WorkerMessage | None = None
        answered = False
        try:
            pipe = self._start_process()
            self._send(pipe, job if job.hand_name in self._sent_hands else replace(job, hand_model=hand))
            self._sent_hands.add(job.hand_name)
            while True:
                over = time.monotonic() - self._deadline  # s
                if over >= 0.0 and not answered:
                    on_timeout(
                        so_far or WorkerMessage(ANSWER, make_plan_reply(job, make_stopped_failure(job, self._cancelled)))
                    )
                    answered = True
                if over >= _STUCK:
                    log.warning("a planning process did not stop, and is ended")
                    self.close()
                    return None
                if not pipe.poll(_POLL_PERIOD):
                    continue
                said: WorkerMessage = pipe.recv()
                if said.kind == ANSWER:
                    return None if answered else said
                if said.kind != PROGRESS:
                    so_far = said
                elif not answered:
                    progress(said.reply)
        except (EOFError, OSError):
            log.exception("the process that planned %s ended", job.id)
            self.close()
            return None if answered else so_far or _process_died(job)
        finally:
            with self._lock:
                self._reserved = False

    def cancel(self) -> None:
        """Stop the job that is claimed, if one is; its answer is the best plan so far."""
        with self._lock:
            if not self._reserved or self._cancelled:
                return
            self._deadline, self._cancelled = min(self._deadline, time.monotonic() + GRACE), True
            if self._job_sent and self._pipe is not None:
                with contextlib.suppress(OSError):  # it is ending
                    self._pipe.send(CANCEL)

    def close(self) -> None:
        """End the process. The next plan starts another."""
        with self._lock:
            process, pipe, self._process, self._pipe = self._process, self._pipe, None, None
            self._sent_hands = set()
        if pipe is not None:
            pipe.close()
        if process is not None:
            process.kill()
            process.wait()

    def _start_process(self) -> Connection:
        with self._lock:
            if self._pipe is not None and self._process is not None and self._process.poll() is None:
                return self._pipe
        self.close()
        ours, theirs = Pipe()
        with theirs:
            number = theirs.fileno()
            process = subprocess.Popen(
                [*self._command, str(number)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,  # some solvers print banners that no option turns off
                env=worker_environment(),
                pass_fds=(number,),
                start_new_session=True,  # Ctrl-C is the server's; it ends its processes in order
            )
        with self._lock:
            self._process, self._pipe = process, ours
        return ours

    def _send(self, pipe: Connection, job: PlanningJob) -> None:
        pipe.send(job)
        with self._lock:
            self._job_sent = True
            if self._cancelled:  # while it started
                pipe.send(CANCEL)


def _process_died(job: PlanningJob) -> WorkerMessage:
    words = "the process that planned it ended; the server's log says more"
    return WorkerMessage(ANSWER, make_error_reply(job.codec, "internal", words, None, job.sequence), "internal")
