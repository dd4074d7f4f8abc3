"""Real-time priorities of a server's streams, bounded in states a second.

A client decides on the period of its stream and on when it sends states. Without bounds it could take the processors from other
streams and from all ordinary programs. Two bounds hold, and a stream beyond them gets the priority of requests:

- the streams with the priority of their period have together at most a number of states a second, by their periods;
- a stream keeps it while its states do not arrive faster than its period says.
"""

from __future__ import annotations

import logging
import threading

from graspforce.service.realtime_scheduling import ServerPriorities

log = logging.getLogger("graspforce.service")

_TOLERANCE = 1.25  # allowed rate of states, relative to that of the period
_BURST = 20.0  # states that may arrive at once, after a pause of the driver or of the network


class StreamPriority:
    """Priority of the thread of one stream, by the rate of its states.

    States fill a bucket, which drains at 1.25 states a period. With more than 20 states in it the thread gets the lower
    priority, and with 10 its own again.

    Args:
        id: id of the stream.
        period: control period, s.
        own: priority of its period.
        lower: priority of a stream that is too fast.
    """

    def __init__(self, id: str, period: float, own: int, lower: int) -> None:
        self._id, self._period, self._own, self._lower = id, period, own, lower
        self._drain, self._level, self._last = _TOLERANCE / period, 0.0, 0.0  # states/s, states, s
        self._is_too_fast = self._was_too_fast = False

    @property
    def present(self) -> int:
        """Priority of the thread after the last state."""
        return self._lower if self._is_too_fast else self._own

    def count_state(self, now: float) -> bool:
        """Count a state. Return whether the priority changes.

        Args:
            now: when it was received, on the clock `time.perf_counter`, s.
        """
        drained = max(self._level - self._drain * (now - self._last), 0.0)
        self._level, self._last = min(drained + 1.0, _BURST + 1.0), now
        is_too_fast = self._level > (0.5 * _BURST if self._is_too_fast else _BURST)
        if is_too_fast == self._is_too_fast:
            return False
        self._is_too_fast = is_too_fast
        if not self._was_too_fast:
            self._was_too_fast = True
            log.warning("stream %s is faster than its period of %g s: its priority is lowered", self._id, self._period)
        return True


class StreamPriorities:
    """Priorities of the open streams. Thread-safe.

    Args:
        server: priorities of the server.
        states: largest number of states a second of all streams with the priority of their period.
    """

    def __init__(self, server: ServerPriorities, states: float) -> None:
        self._server, self._states = server, states
        self._lock = threading.Lock()
        self._rates: dict[str, float] = {}  # of the streams with the priority of their period, 1/s

    def open(self, id: str, period: float) -> StreamPriority | None:
        """Return the priority of a new stream; None for ordinary scheduling.

        Args:
            id: id of the stream.
            period: control period, s.
        """
        own, requests, rate = self._server.of_stream(period), self._server.requests, 1.0 / period
        if own is None or requests is None:
            return None
        with self._lock:
            is_allowed = sum(self._rates.values()) + rate <= self._states
            if is_allowed:
                self._rates[id] = rate
        if not is_allowed:
            log.warning("stream %s gets the priority of requests: real-time streams have %g states/s at most", id, self._states)
        return StreamPriority(id, period, own if is_allowed else requests, requests)

    def close(self, id: str) -> None:
        """Free the share of a closed stream.

        Args:
            id: id of the stream.
        """
        with self._lock:
            self._rates.pop(id, None)
