"""The records that only the wire knows: a hand's force distribution as it is asked for, and the server's own status."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from graspforce.core import fields


@dataclass(frozen=True, slots=True)
class ServerStatus:
    """How a server does.

    Args:
        version: graspforce's version.
        server: the server's id, as its liveliness token says it.
        uptime: since it began to serve, s.
        hands: the hands it serves.
        queue: requests that wait for a worker.
        streams: control streams that are open.
        plans: moves that are being planned.
        counts: for each key, how many requests ended how: "ok", or an error's code; under ``streams/*/state`` the states.
        latency: "count", and "p50", "p99" and "max" in s, over the last requests that were worked on, from receipt to answer;
            null before the first.
    """

    version: str
    server: str
    uptime: float
    hands: tuple[str, ...]
    queue: int
    streams: int
    plans: int
    counts: Mapping[str, Mapping[str, int]]
    latency: Mapping[str, float | None]

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> ServerStatus:
        """From the record on the wire.

        Raises:
            InvalidInput: not such a record.
        """
        values = fields.check_record(record, "", required=[name.name for name in dataclasses.fields(cls)])
        return cls(**{**values, "hands": tuple(values["hands"])})

    def to_dict(self) -> dict[str, Any]:
        """The record on the wire."""
        return {name.name: getattr(self, name.name) for name in dataclasses.fields(self)}
