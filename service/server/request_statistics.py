"""What a server counts: how requests ended, by key, and how long they took."""

from __future__ import annotations

import threading
from collections import Counter, deque
from typing import Any

import numpy as np

_WINDOW = 4096  # requests over which latencies are summed up


class RequestStatistics:
    """Counts and latencies, safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: dict[str, Counter[str]] = {}
        self._seconds: deque[float] = deque(maxlen=_WINDOW)

    def count(self, key: str, outcome: str, seconds: float | None = None) -> None:
        """One request is done.

        Args:
            key: what was asked; the caller names only keys that exist, so that strangers cannot grow the table.
            outcome: "ok" or an error's code.
            seconds: from receipt to answer, s; None for a request that was not worked on.
        """
        with self._lock:
            self._counts.setdefault(key, Counter())[outcome] += 1
            if seconds is not None:
                self._seconds.append(seconds)

    def counts(self) -> dict[str, dict[str, int]]:
        """For each key, how many requests ended how."""
        with self._lock:
            return {key: dict(outcomes) for key, outcomes in sorted(self._counts.items())}

    def latency(self) -> dict[str, Any]:
        """Count, median, 99th percentile and maximum, s, over the last requests; None for figures of nothing."""
        with self._lock:
            seconds = np.array(self._seconds)
        if not len(seconds):
            return {"count": 0, "p50": None, "p99": None, "max": None}
        p50, p99 = np.percentile(seconds, [50, 99])
        return {"count": len(seconds), "p50": float(p50), "p99": float(p99), "max": float(seconds.max())}
