"""Histograms of latencies, which the server counts and its status contains."""

from __future__ import annotations

import math
from bisect import bisect_left

from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord

BOUNDS = (
    *(5e-5, 1e-4, 2e-4, 3e-4, 5e-4, 7e-4, 1e-3, 1.5e-3, 2e-3, 3e-3, 5e-3, 1e-2, 2e-2, 5e-2),
    *(0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0),
)
"""Upper bounds of the buckets, s. One more bucket holds longer times."""

_MAX_COUNT = 2**63 - 1


class LatencyHistogram:
    """Number of latencies by bucket. One thread at a time observes; others may read.

    Attributes:
        counts: number of latencies in each bucket of `BOUNDS`, and of longer ones.
        total: sum of the latencies, s.
        largest: largest latency, s; 0 before the first.
    """

    __slots__ = ("counts", "largest", "total")

    def __init__(self) -> None:
        self.counts = [0] * (len(BOUNDS) + 1)
        self.total = self.largest = 0.0

    def observe(self, seconds: float) -> None:
        """Count a latency.

        Args:
            seconds: the latency, s.
        """
        self.counts[bisect_left(BOUNDS, seconds)] += 1
        self.total += seconds
        if seconds > self.largest:
            self.largest = seconds

    def __len__(self) -> int:
        return sum(self.counts)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LatencyHistogram) and self.to_dict() == other.to_dict()

    __hash__ = None  # type: ignore[assignment]  # it changes

    def quantile(self, fraction: float) -> float | None:
        """Return an upper bound of a quantile: the bound of its bucket, at most the largest latency, s. None before the first.

        Args:
            fraction: fraction of the latencies that are not longer, from 0 to 1.
        """
        rank, seen = fraction * len(self), 0
        if not any(self.counts):
            return None
        for bound, count in zip((*BOUNDS, math.inf), self.counts, strict=True):
            seen += count
            if count and seen >= rank:
                return min(bound, self.largest)
        return self.largest

    def to_dict(self) -> JsonRecord:
        """Return the plain record."""
        return {"counts": list(self.counts), "total": self.total, "largest": self.largest}

    @classmethod
    def from_dict(cls, record: object, field: str = "") -> LatencyHistogram:
        """Read a histogram from its record.

        Args:
            record: as `to_dict` returns it.
            field: its path for error messages.

        Raises:
            InvalidInput: a field is missing, or the buckets are others.
        """
        values = fields.check_record(record, field, required=["counts", "total", "largest"], optional=None)
        counts = fields.check_sequence(values["counts"], f"{field}.counts")
        if len(counts) != len(BOUNDS) + 1:
            raise InvalidInput(f"{field}.counts", len(counts), f"counts of {len(BOUNDS) + 1} buckets")
        read = cls()
        read.counts = [
            fields.check_integer(count, f"{field}.counts[{k}]", minimum=0, maximum=_MAX_COUNT) for k, count in enumerate(counts)
        ]
        read.total = arrays.check_number(values["total"], f"{field}.total", minimum=0.0)
        read.largest = arrays.check_number(values["largest"], f"{field}.largest", minimum=0.0)
        return read
