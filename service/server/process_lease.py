"""The lease of a replica: a process that has been frozen for longer gives up its streams.

While a process is frozen, another replica opens its streams. When it wakes, its clock shows the interruption before it answers
any state. It then closes all streams without a message, and their commands in progress are not sent. The epoch of a stream
(`graspforce.service.server.server_stream`) covers the microseconds between the check and the message. Requests to open streams
that were sent meanwhile get no answer: their clients have gone to another replica.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable

log = logging.getLogger("graspforce.service")

_RENEWALS = 5  # of a lease, while the process runs
_WAKING_TIME = 0.1  # s, in which the messages of an interruption arrive


class ProcessLease:
    """Whether this process has run without an interruption of its lease. Thread-safe.

    Args:
        seconds: duration of the lease, s; None for a lease without end.
        on_lost: called after an interruption, before the lease begins again.
        clock: a clock that advances while the process is frozen, s.
    """

    def __init__(self, seconds: float | None, on_lost: Callable[[], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._seconds, self._on_lost, self._clock = seconds, on_lost, clock
        self._renewed = clock()
        self._woken = -math.inf  # end of the last interruption, s
        self._closed = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def holds(self) -> bool:
        """Whether the lease has not ended since its last renewal."""
        return self._seconds is None or self._clock() - self._renewed <= self._seconds

    @property
    def is_waking(self) -> bool:
        """Whether an interruption has just ended, so that messages of this time may arrive."""
        return not self.holds or self._clock() - self._woken < _WAKING_TIME

    def start(self) -> None:
        """Renew the lease from now on, in a thread."""
        self._closed.clear()
        self._renewed = self._clock()
        if self._seconds is not None:
            self._thread = threading.Thread(target=self._run, args=(self._seconds,), name="lease", daemon=True)
            self._thread.start()

    def renew(self) -> None:
        """Renew the lease; after an interruption, call `on_lost` first."""
        if self.holds:
            self._renewed = self._clock()
            return
        log.warning("the process did not run for %.3f s: its streams are given up", self._clock() - self._renewed)
        self._on_lost()
        self._renewed = self._woken = self._clock()

    def close(self) -> None:
        """Stop renewing the lease."""
        self._closed.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self, seconds: float) -> None:
        """Renew the lease until it is closed."""
        while not self._closed.wait(seconds / _RENEWALS):
            self.renew()
