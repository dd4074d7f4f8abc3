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

from graspforce.hand import Hand
from graspforce.service.planning_process import ANSWER, CANCEL, PROGRESS, Job, Message, environment, nothing, reply
from graspforce.service.reply import Reply, error_reply

log = logging.getLogger("graspforce.service")

GRACE = 0.5  # s beyond its budget, or after a cancel, that a process has to answer; then the best plan so far is the answer
_STUCK = 20.0  # s that it may go on after that: what it builds of a hand on the way is worth keeping
_TURN = 0.05  # s between looks at the clock
_START = "from graspforce.service.planning_process import main; main()"


class Planner:
    """One planning process. One thread at a time gives it jobs; any thread may cancel.

    Args:
        command: what is started in place of a planning process.
    """

    def __init__(self, command: tuple[str, ...] = (sys.executable, "-c", _START)) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Connection | None = None
        self._known: set[str] = set()
        self._lock = threading.Lock()
        self._end = 0.0  # on the clock `time.monotonic`, s: when the answer must have gone out
        self._claimed = self._sent = self._told = False

    def claim(self, budget: float) -> None:
        """The next job is one's own, and may be cancelled from now on.

        Args:
            budget: s that it may take from now.
        """
        with self._lock:
            self._end, self._claimed, self._sent, self._told = time.monotonic() + budget + GRACE, True, False, False

    def plan(self, job: Job, hand: Hand, progress: Callable[[Reply], None], late: Callable[[Message], None]) -> Message | None:
        """The answer to the job that was claimed.

        Where the process has none by the end of the budget and the grace, the best plan so far is the answer, or that there is
        none: ``late`` is called with it, and this returns None when the process is free again, or has been ended.

        Args:
            job: the move.
            hand: the hand that it names.
            progress: called with how far it is.
            late: called at most once.
        """
        so_far: Message | None = None
        answered = False
        try:
            pipe = self._started()
            self._send(pipe, job if job.hand in self._known else replace(job, known=hand))
            self._known.add(job.hand)
            while True:
                over = time.monotonic() - self._end  # s
                if over >= 0.0 and not answered:
                    late(so_far or Message(ANSWER, reply(job, nothing(job, self._told))))
                    answered = True
                if over >= _STUCK:
                    log.warning("a planning process did not stop, and is ended")
                    self.close()
                    return None
                if not pipe.poll(_TURN):
                    continue
                said: Message = pipe.recv()
                if said.kind == ANSWER:
                    return None if answered else said
                if said.kind != PROGRESS:
                    so_far = said
                elif not answered:
                    progress(said.reply)
        except (EOFError, OSError):
            log.exception("the process that planned %s ended", job.id)
            self.close()
            return None if answered else so_far or _died(job)
        finally:
            with self._lock:
                self._claimed = False

    def cancel(self) -> None:
        """Stop the job that is claimed, if one is; its answer is the best plan so far."""
        with self._lock:
            if not self._claimed or self._told:
                return
            self._end, self._told = min(self._end, time.monotonic() + GRACE), True
            if self._sent and self._pipe is not None:
                with contextlib.suppress(OSError):  # it is ending
                    self._pipe.send(CANCEL)

    def close(self) -> None:
        """End the process. The next plan starts another."""
        with self._lock:
            process, pipe, self._process, self._pipe = self._process, self._pipe, None, None
            self._known = set()
        if pipe is not None:
            pipe.close()
        if process is not None:
            process.kill()
            process.wait()

    def _started(self) -> Connection:
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
                env=environment(),
                pass_fds=(number,),
                start_new_session=True,  # Ctrl-C is the server's; it ends its processes in order
            )
        with self._lock:
            self._process, self._pipe = process, ours
        return ours

    def _send(self, pipe: Connection, job: Job) -> None:
        pipe.send(job)
        with self._lock:
            self._sent = True
            if self._told:  # while it started
                pipe.send(CANCEL)


def _died(job: Job) -> Message:
    words = "the process that planned it ended; the server's log says more"
    return Message(ANSWER, error_reply(job.codec, "internal", words, None, job.sequence), "internal")
