"""Statistics of a server: requests by key and outcome, and latencies."""

from __future__ import annotations

import threading
from collections import Counter, deque

import numpy as np

from graspforce.service.wire.latency_histogram import LatencyHistogram

_WINDOW = 4096  # number of last requests whose latencies count


class RequestStatistics:
    """Counts and latencies of requests. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: dict[str, Counter[str]] = {}
        self._seconds: deque[float] = deque(maxlen=_WINDOW)
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
                self._seconds.append(seconds)
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
            seconds = np.array(self._seconds)
        if not len(seconds):
            return {"count": 0, "p50": None, "p99": None, "max": None}
        p50, p99 = np.percentile(seconds, [50, 99])
        return {"count": len(seconds), "p50": float(p50), "p99": float(p99), "max": float(seconds.max())}
