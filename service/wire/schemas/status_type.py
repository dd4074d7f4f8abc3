"""Type of the record of a server's status."""

from __future__ import annotations

from msgspec import Struct

from graspforce.service.wire.schemas.array_types import Index, NotNegative
from graspforce.service.wire.schemas.solution_types import ReplyEnvelope


class HistogramRecord(Struct, kw_only=True):
    """Times from receipt to reply.

    Args:
        counts: number of requests in each bucket.
        total: sum of the times, s.
        largest: longest time, s.
    """

    counts: list[Index]
    total: NotNegative
    largest: NotNegative


class StreamStatusRecord(Struct, kw_only=True):
    """Counts and latencies of an open stream.

    Args:
        id: its id.
        hand: name of its hand.
        client: label of the session that opened it.
        outcomes: number of states by outcome.
        skipped: states that newer ones replaced before they were read.
        late: commands that were finished later than their validity.
        idle: time since the last valid state, s.
        latency: times from receipt of a state to its command.
    """

    id: str
    hand: str
    client: str
    outcomes: dict[str, Index]
    skipped: Index
    late: Index
    idle: float
    latency: HistogramRecord


class StatusReply(ReplyEnvelope, kw_only=True):
    """The reply to `status`.

    Args:
        version: version of graspforce.
        server: id of the server, as in its liveliness token.
        uptime: time since it started to serve, s.
        hands: names of the served hands.
        queue: requests that wait for a solver thread.
        streams: open streams.
        plans: plans in progress.
        counts: by key, the number of requests by outcome.
        latency: time from receipt to reply over the last requests: `count`, and `p50`, `p99` and `max` in s.
        versions: versions of the wire: the second parts of the keys.
        capabilities: what the server offers beyond the first version of the wire.
        queue_bytes: bytes of the waiting requests.
        problem: why the server cannot take work; null if it can.
        memory: resident memory of the server's process, bytes.
        latencies: by key, the times of all requests.
        active_streams: status of each open stream.
        clients: by label of a client, its number of waiting requests, streams and plans.
        addresses: Zenoh endpoints at which clients reach it: those at which it listens, and the routers that it joined.
    """

    version: str
    server: str
    uptime: NotNegative
    hands: list[str]
    queue: Index
    streams: Index
    plans: Index
    counts: dict[str, dict[str, Index]]
    latency: dict[str, float | None]
    versions: list[str]
    capabilities: list[str]
    queue_bytes: Index
    problem: str | None
    memory: Index
    latencies: dict[str, HistogramRecord]
    active_streams: list[StreamStatusRecord]
    clients: dict[str, dict[str, Index]]
    addresses: list[str]
