"""The status of a server."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from graspforce.core import fields
from graspforce.core.json_text import JsonRecord
from graspforce.core.printable import escape_controls
from graspforce.service.wire import protocol

_LISTS = ("hands", "versions", "capabilities")


@dataclass(frozen=True, slots=True)
class ServerStatus:
    """Health and counts of a server. `print(status)` shows a table.

    Args:
        version: version of graspforce.
        server: id of the server, as in its liveliness token.
        uptime: time since it started to serve, s.
        hands: names of the served hands.
        queue: requests that wait for a solver thread.
        streams: open control streams.
        plans: moves that are being planned.
        counts: by key, the number of requests by outcome: "ok" or an error code. ``streams/*/state`` counts states of streams.
        latency: time from receipt to answer over the last requests: "count", and "p50", "p99" and "max" in s, None before the
            first.
        versions: versions of the wire that it serves: the second parts of its keys.
        capabilities: what it offers beyond the first version of the wire, by name.
        queue_bytes: bytes of the waiting requests.
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
    versions: tuple[str, ...] = (protocol.VERSION,)
    capabilities: tuple[str, ...] = ()
    queue_bytes: int = 0

    @classmethod
    def from_dict(cls, record: object) -> ServerStatus:
        """Read the status from its record.

        Args:
            record: as `to_dict` returns it. Unknown fields, of a newer server, are ignored; later fields may be absent.

        Raises:
            InvalidInput: a field is missing or has the wrong type; names it.
        """
        own = dataclasses.fields(cls)
        required = [each.name for each in own if each.default is dataclasses.MISSING]
        values = fields.check_record(record, "", required=required, optional=None)
        given = {each.name: values[each.name] for each in own if each.name in values}
        lists = {name: tuple(fields.check_sequence(given[name], name)) for name in _LISTS if name in given}
        return cls(**{**given, **lists})

    def to_dict(self) -> JsonRecord:
        """Return the plain record."""
        return {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}

    def __str__(self) -> str:
        """Return a table of the server's state and of its requests by key and outcome."""
        p50, p99, largest = (self.latency.get(name) for name in ("p50", "p99", "max"))
        latency = "no requests yet"
        if p50 is not None and p99 is not None and largest is not None:
            milliseconds = f"{1e3 * p50:.2f} ms median, {1e3 * p99:.2f} ms p99, {1e3 * largest:.2f} ms largest"
            latency = f"{milliseconds} of {self.latency['count']} requests"
        rows = [
            ("server", f"{self.server}, graspforce {self.version}, up {self.uptime:.0f} s"),
            ("hands", ", ".join(self.hands) or "none"),
            ("waiting", f"{self.queue} requests"),
            ("open", f"{self.streams} streams, {self.plans} plans"),
            ("latency", latency),
        ]
        lines = [f"{name:<8} {escape_controls(value)}" for name, value in rows]
        outcomes = sorted({outcome for row in self.counts.values() for outcome in row}, key=lambda each: (each != "ok", each))
        if outcomes:
            width = max(map(len, (*self.counts, "requests")))
            lines += ["", " ".join([f"{'requests':<{width}}", *(f"{outcome:>10}" for outcome in outcomes)])]
            for key, row in self.counts.items():
                lines.append(
                    " ".join([f"{escape_controls(key):<{width}}", *(f"{row.get(outcome, 0):>10}" for outcome in outcomes)])
                )
        return "\n".join(lines)
