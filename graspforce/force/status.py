"""Status of a solution: optimal, inaccurate, infeasible or failed."""

from __future__ import annotations

from enum import Enum


class Status(str, Enum):
    """Status of a solution. The value is the word in files and on the wire; `sentence` explains it."""

    OPTIMAL = "optimal"
    INACCURATE = "inaccurate"
    INFEASIBLE = "infeasible"
    FAILED = "failed"

    @property
    def sentence(self) -> str:
        """Return the meaning of the status as a sentence."""
        return _SENTENCES[self]


_SENTENCES = {
    Status.OPTIMAL: "The forces satisfy every limit at the lowest cost; the certificate proves it.",
    Status.INACCURATE: "The forces are optimal only to the looser tolerance of the certificate.",
    Status.INFEASIBLE: "No forces satisfy every limit; the multipliers prove it.",
    Status.FAILED: "No solver found forces or a proof of infeasibility.",
}
