"""Deadlines that a signal handler can bring forward."""

from __future__ import annotations

import threading
import time

_PERIOD = 0.1  # s; Python delays a signal that arrives just before a wait until the wait ends


class Deadline:
    """A latest time of waits, on the clock `time.monotonic`.

    Args:
        grace: time until the deadline, s.
    """

    def __init__(self, grace: float) -> None:
        self._time = time.monotonic() + grace

    @property
    def remaining(self) -> float:
        """Time until the deadline, s; zero after it."""
        return max(self._time - time.monotonic(), 0.0)

    def expire(self) -> None:
        """End all waits now. A signal handler may call it."""
        self._time = time.monotonic()

    def limit(self, grace: float) -> None:
        """Bring the deadline forward to at most a time from now; an earlier deadline stays.

        Args:
            grace: time from now, s.
        """
        self._time = min(self._time, time.monotonic() + grace)

    def join(self, thread: threading.Thread, extra: float = 0.0) -> None:
        """Wait for a thread until the deadline. Signals are handled during the wait.

        Args:
            thread: the thread.
            extra: time to wait after the deadline, s.
        """
        while thread.is_alive() and (remaining := self._time + extra - time.monotonic()) > 0.0:
            thread.join(min(remaining, _PERIOD))
