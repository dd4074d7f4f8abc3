"""The status of a server."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

from graspforce.core import fields
from graspforce.core.json_text import JsonRecord
from graspforce.core.printable import escape_controls
from graspforce.service.wire import protocol
from graspforce.service.wire.latency_histogram import LatencyHistogram
from graspforce.service.wire.stream_status import StreamStatus

_LISTS = ("hands", "versions", "capabilities", "addresses")


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
        problem: why the server cannot take work, or None.
        memory: resident memory of the server's process, bytes.
        latencies: by key, the times from receipt to answer of all requests.
        active_streams: status of each open stream.
        clients: by label of a client, its number of "waiting" requests, "streams" and "plans".
        addresses: Zenoh endpoints at which clients reach it: those at which it listens, and the routers that it joined.
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
    problem: str | None = None
    memory: int = 0
    latencies: Mapping[str, LatencyHistogram] = field(default_factory=dict)
    active_streams: tuple[StreamStatus, ...] = ()
    clients: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    addresses: tuple[str, ...] = ()

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
        lists: JsonRecord = {name: tuple(fields.check_sequence(given[name], name)) for name in _LISTS if name in given}
        if "latencies" in given:
            records = fields.check_record(given["latencies"], "latencies", optional=None)
            lists["latencies"] = {key: LatencyHistogram.from_dict(each, f"latencies.{key}") for key, each in records.items()}
        if "active_streams" in given:
            each_stream = enumerate(fields.check_sequence(given["active_streams"], "active_streams"))
            lists["active_streams"] = tuple(StreamStatus.from_dict(each, f"active_streams[{k}]") for k, each in each_stream)
        return cls(**{**given, **lists})

    def to_dict(self) -> JsonRecord:
        """Return the plain record."""
        record = {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}
        record["latencies"] = {key: each.to_dict() for key, each in self.latencies.items()}
        record["active_streams"] = [each.to_dict() for each in self.active_streams]
        return record

    def __str__(self) -> str:
        """Return a table of the server's state and of its requests by key and outcome."""
        p50, p99, largest = (self.latency.get(name) for name in ("p50", "p99", "max"))
        latency = "no requests yet"
        if p50 is not None and p99 is not None and largest is not None:
            milliseconds = f"{1e3 * p50:.2f} ms median, {1e3 * p99:.2f} ms p99, {1e3 * largest:.2f} ms largest"
            latency = f"{milliseconds} of {self.latency['count']} requests"
        rows = [
            ("server", f"{self.server}, graspforce {self.version}, up {self.uptime:.0f} s"),
            *([("at", ", ".join(self.addresses))] if self.addresses else []),
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
