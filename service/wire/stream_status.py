"""The status of one control stream."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from graspforce.core import arrays, fields
from graspforce.core.json_text import JsonRecord
from graspforce.service.wire.latency_histogram import LatencyHistogram


@dataclass(frozen=True, slots=True)
class StreamStatus:
    """Counts and latencies of an open control stream.

    Args:
        id: its id.
        hand: name of its hand.
        client: label of the session that opened it.
        outcomes: number of states by outcome: "ok" or an error code; "forged" and "replayed" states got no reply.
        skipped: states that newer ones replaced before they were read.
        late: commands that were finished later than their validity after receipt of the state.
        idle: time since the last valid state, s.
        latency: time from receipt of a state to its command.
    """

    id: str
    hand: str
    client: str
    outcomes: Mapping[str, int]
    skipped: int
    late: int
    idle: float
    latency: LatencyHistogram

    def to_dict(self) -> JsonRecord:
        """Return the plain record."""
        return {
            "id": self.id,
            "hand": self.hand,
            "client": self.client,
            "outcomes": dict(self.outcomes),
            "skipped": self.skipped,
            "late": self.late,
            "idle": self.idle,
            "latency": self.latency.to_dict(),
        }

    @classmethod
    def from_dict(cls, record: object, field: str = "") -> StreamStatus:
        """Read the status from its record.

        Args:
            record: as `to_dict` returns it. Unknown fields, of a newer server, are ignored.
            field: its path for error messages.

        Raises:
            InvalidInput: a field is missing or has the wrong type; names it.
        """
        names = ["id", "hand", "client", "outcomes", "skipped", "late", "idle", "latency"]
        values = fields.check_record(record, field, required=names, optional=None)
        return cls(
            id=fields.check_text(values["id"], f"{field}.id"),
            hand=fields.check_text(values["hand"], f"{field}.hand"),
            client=fields.check_text(values["client"], f"{field}.client"),
            outcomes=fields.check_record(values["outcomes"], f"{field}.outcomes", optional=None),
            skipped=int(arrays.check_number(values["skipped"], f"{field}.skipped", minimum=0.0)),
            late=int(arrays.check_number(values["late"], f"{field}.late", minimum=0.0)),
            idle=arrays.check_number(values["idle"], f"{field}.idle"),
            latency=LatencyHistogram.from_dict(values["latency"], f"{field}.latency"),
        )
