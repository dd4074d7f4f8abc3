"""The result of a replay."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from graspforce.core.json_text import JsonRecord
from graspforce.service.replay.differences import Difference

_MAX_EXAMPLES = 3  # differences of a source that are kept


@dataclass(slots=True)
class SourceResult:
    """Replies to the requests of one key, or to the states of one stream.

    Attributes:
        count: recorded exchanges.
        equal: replies that are equal to the bit, apart from times.
        different: replies that differ.
        explained: replies that differ, or were not computed again, by reason.
        examples: first differences, each with the number of its exchange from 0.
        largest: largest relative difference of numbers.
    """

    count: int = 0
    equal: int = 0
    different: int = 0
    explained: Counter[str] = field(default_factory=Counter)
    examples: list[tuple[int, Difference]] = field(default_factory=list)
    largest: float = 0.0

    def add(self, found: list[Difference]) -> None:
        """Count a reply.

        Args:
            found: its differences.
        """
        if not found:
            self.equal += 1
        else:
            self.different += 1
            self.largest = max(self.largest, *(each.size for each in found))
            if len(self.examples) < _MAX_EXAMPLES:
                self.examples.append((self.count, found[0]))
        self.count += 1

    def explain(self, reason: str) -> None:
        """Count a reply that is not compared, or whose difference has a known reason.

        Args:
            reason: the reason.
        """
        self.explained[reason] += 1
        self.count += 1

    def to_dict(self) -> JsonRecord:
        """Return a plain record."""
        examples = [{"exchange": number, **each.to_dict()} for number, each in self.examples]
        counts = {"count": self.count, "equal": self.equal, "different": self.different}
        return {**counts, "explained": dict(self.explained), "differences": examples}


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """Result of a replay.

    Attributes:
        sources: results by source: ``requests/<key>`` or ``streams/<id>``.
        dropped: number of dropped exchanges of the recording by source.
        notes: facts that may explain differences, such as another version.
    """

    sources: dict[str, SourceResult]
    dropped: dict[str, int]
    notes: tuple[str, ...]

    @property
    def is_equal(self) -> bool:
        """Whether no reply differs without a known reason."""
        return not any(each.different for each in self.sources.values())

    @property
    def count(self) -> int:
        """Number of exchanges."""
        return sum(each.count for each in self.sources.values())

    @property
    def equal(self) -> int:
        """Number of replies that are equal to the bit."""
        return sum(each.equal for each in self.sources.values())

    def to_dict(self) -> JsonRecord:
        """Return a plain record."""
        sources = {name: each.to_dict() for name, each in self.sources.items()}
        return {"equal": self.is_equal, "sources": sources, "dropped": self.dropped, "notes": list(self.notes)}
