"""The server's handle of a planning process: start, run a job, cancel, and kill it if it does not stop.

The process starts with its first job and stays for later ones. At the end of the budget plus `GRACE`, the job is answered with
the best plan so far. The process may go on for `_KILL_DELAY` more, because the equations of the hand that it builds serve later
jobs; then it is killed.
"""

from __future__ import annotations

import contextlib
import logging
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection

from graspforce.hand.hand import Hand
from graspforce.service.wire.reply import Reply, make_error_reply
from graspforce.service.workers.jobs import (
    ANSWER,
    CANCEL,
    PROGRESS,
    PlanningJob,
    WorkerMessage,
    make_stopped_answer,
)
from graspforce.service.workers.worker_process import start_piped_worker

log = logging.getLogger("graspforce.service")

GRACE = 0.5  # s after the budget, or after a cancel, in which the process may still answer
_NICENESS = 10  # of the process: streams have priority if processors are short
_KILL_DELAY = 20.0  # s after that until it is killed
_POLL_PERIOD = 0.05  # s, between checks of the clock
_START = "from graspforce.service.workers.planning_process import main; main()"


class PlanningWorker:
    """One planning process. One thread at a time gives it jobs; any thread may cancel.

    Args:
        command: command line of the process; its memory limit and the number of its pipe are appended.
        memory: largest address space of the process, bytes; 0 for no limit.
    """

    def __init__(self, command: tuple[str, ...] = (sys.executable, "-c", _START), memory: int = 0) -> None:
        self._command = (*command, str(memory))
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Connection | None = None
        self._sent_hands: set[str] = set()
        self._lock = threading.Lock()
        self._deadline = 0.0  # when the answer must be sent, on the clock `time.monotonic`, s
        self._reserved = self._job_sent = self._cancelled = self._is_closed = False

    def start(self) -> None:
        """Start the process before its first job, with errors only logged: the first job tries again."""
        try:
            if not self._is_closed:
                self._start_process()
        except OSError:
            log.exception("cannot start a planning process")
        if self._is_closed:
            self._kill_process()

    def forget_hand(self, name: str) -> None:
        """Send a hand again with its next job, because it has changed.

        Args:
            name: its name.
        """
        self._sent_hands.discard(name)

    def reserve(self, budget: float) -> None:
        """Reserve the worker for the next job of the caller, which may be cancelled from now on.

        Args:
            budget: time for the job, s.
        """
        with self._lock:
            self._deadline = time.monotonic() + budget + GRACE
            self._reserved, self._job_sent, self._cancelled = True, False, False

    def plan(
        self, job: PlanningJob, hand: Hand, progress: Callable[[Reply], None], on_timeout: Callable[[WorkerMessage], None]
    ) -> WorkerMessage | None:
        """Run the job that the worker is reserved for, and wait until the process is free again.

        Args:
            job: the job.
            hand: its hand.
            progress: called with each progress record.
            on_timeout: called at most once, at the end of budget and grace, with the best plan so far or a failure.

        Returns:
            The answer; None if `on_timeout` was called.
        """
        best: WorkerMessage | None = None
        answered = False
        try:
            pipe = self._start_process()
            self._send(pipe, job if job.hand_name in self._sent_hands else replace(job, hand_model=hand))
            self._sent_hands.add(job.hand_name)
            while True:
                overtime = time.monotonic() - self._deadline  # s
                if overtime >= 0.0 and not answered:
                    on_timeout(best or make_stopped_answer(job, self._cancelled))
                    answered = True
                if overtime >= _KILL_DELAY:
                    log.warning("planning process killed: it did not stop within %g s of its deadline", _KILL_DELAY)
                    self._kill_process()
                    return None
                if not pipe.poll(_POLL_PERIOD):
                    continue
                message: WorkerMessage = pipe.recv()
                if message.kind == ANSWER:
                    return None if answered else message
                if message.kind != PROGRESS:
                    best = message
                elif not answered:
                    progress(message.reply)
        except (EOFError, OSError):
            if self._is_closed:  # by `close`: the server ends
                return None if answered else best or make_stopped_answer(job, cancelled=True)
            log.exception("planning process ended during plan %s", job.id)
            self._kill_process()
            return None if answered else best or _make_died_answer(job)
        finally:
            with self._lock:
                self._reserved = False

    def cancel(self) -> None:
        """Stop the job that the worker is reserved for; its answer is the best plan so far."""
        with self._lock:
            if not self._reserved or self._cancelled:
                return
            self._deadline, self._cancelled = min(self._deadline, time.monotonic() + GRACE), True
            if self._job_sent and self._pipe is not None:
                with contextlib.suppress(OSError):  # the process is ending
                    self._pipe.send(CANCEL)

    def close(self) -> None:
        """Kill the process, and end its job: the answer is the best plan so far. No further job is accepted."""
        self._is_closed = True
        self._kill_process()

    def _kill_process(self) -> None:
        """Kill the process. The next job starts another."""
        with self._lock:
            process, pipe, self._process, self._pipe = self._process, self._pipe, None, None
            self._sent_hands = set()
        if pipe is not None:
            pipe.close()
        if process is not None:
            process.kill()
            process.wait()

    def _start_process(self) -> Connection:
        """Return the pipe to the running process; start one if there is none."""
        with self._lock:
            if self._pipe is not None and self._process is not None and self._process.poll() is None:
                return self._pipe
        self._kill_process()
        process, ours = start_piped_worker(self._command, _NICENESS)
        with self._lock:
            self._process, self._pipe = process, ours
        return ours

    def _send(self, pipe: Connection, job: PlanningJob) -> None:
        """Send the job, and the cancel that arrived while the process started."""
        pipe.send(job)
        with self._lock:
            self._job_sent = True
            if self._cancelled:
                pipe.send(CANCEL)


def _make_died_answer(job: PlanningJob) -> WorkerMessage:
    """Return the error record of a job whose process ended without a result."""
    text = "the planning process ended unexpectedly; the server's log has the details"
    return WorkerMessage(ANSWER, make_error_reply(job.codec, "internal", text, None, job.sequence), "internal")
