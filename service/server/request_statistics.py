"""Statistics of a server: requests by key and outcome, and latencies."""

from __future__ import annotations

import math
import threading
from collections import Counter

import numpy as np

from graspforce.service.wire.latency_histogram import LatencyHistogram

_WINDOW = 4096  # number of last requests whose latencies count


class RequestStatistics:
    """Counts and latencies of requests. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: dict[str, Counter[str]] = {}
        self._seconds = np.zeros(_WINDOW)  # s; a ring
        self._timed = 0  # requests with a time
        self._histograms: dict[str, LatencyHistogram] = {}

    def count(self, key: str, outcome: str, seconds: float | None = None) -> None:
        """Count one request.

        Args:
            key: its key; the caller passes only existing keys, so that clients cannot grow the table.
            outcome: "ok" or an error code.
            seconds: time from receipt to answer, s; None for a request without work.
        """
        with self._lock:
            self._counts.setdefault(key, Counter())[outcome] += 1
            if seconds is not None:
                self._seconds[self._timed % _WINDOW] = seconds
                self._timed += 1
                self._histograms.setdefault(key, LatencyHistogram()).observe(seconds)

    def counts(self) -> dict[str, dict[str, int]]:
        """Return the number of requests by key and outcome."""
        with self._lock:
            return {key: dict(outcomes) for key, outcomes in sorted(self._counts.items())}

    def histograms(self) -> dict[str, LatencyHistogram]:
        """Return the latencies of all requests by key. The histograms go on counting."""
        with self._lock:
            return dict(sorted(self._histograms.items()))

    def latency(self) -> dict[str, float | None]:
        """Return "count", and "p50", "p99" and "max" in s, of the last requests; None before the first."""
        with self._lock:
            seconds = self._seconds[: self._timed].copy()
        count = len(seconds)
        if not count:
            return {"count": 0, "p50": None, "p99": None, "max": None}
        ranks = [math.ceil(fraction * count) - 1 for fraction in (0.5, 0.99, 1.0)]
        p50, p99, largest = np.partition(seconds, ranks)[ranks].tolist()  # a tenth of the time of `np.percentile`
        return {"count": count, "p50": p50, "p99": p99, "max": largest}
