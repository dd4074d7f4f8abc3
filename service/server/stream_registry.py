"""The open control streams of a server: open, close, and expire when idle. It does not use the network."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Mapping

from graspforce.core import fields
from graspforce.core.errors import InvalidInput, RequestRefused, UnknownName
from graspforce.core.json_text import JsonRecord
from graspforce.hand.hand import Hand
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.stream_setups import read_setup
from graspforce.service.wire.stream_status import StreamStatus


class StreamRegistry:
    """The open control streams by id. Thread-safe.

    Args:
        hands: the served hands by name.
        capacity: largest number of open streams; beyond, ``overloaded``.
        client_capacity: largest number of open streams of a client; beyond, ``overloaded``.
        idle_timeout: time without states after which a stream is closed, s.
        on_open: called with each new stream, before its client gets the answer.
        on_close: called with each closed stream.
    """

    def __init__(
        self,
        hands: Mapping[str, Hand],
        *,
        capacity: int,
        client_capacity: int | None = None,
        idle_timeout: float,
        on_open: Callable[[ServerStream], None] = lambda stream: None,
        on_close: Callable[[ServerStream], None] = lambda stream: None,
    ) -> None:
        self._hands, self._capacity, self.idle_timeout = hands, capacity, idle_timeout
        self._client_capacity = capacity if client_capacity is None else client_capacity
        self._on_open, self._on_close = on_open, on_close
        self._lock = threading.Lock()
        self._open: dict[str, ServerStream] = {}
        self._closed_outcomes: Counter[str] = Counter()  # of the states of closed streams

    def __len__(self) -> int:
        return len(self._open)

    def __getitem__(self, id: str) -> ServerStream:
        return self._open[id]

    def outcomes(self) -> dict[str, int]:
        """Return the number of states by outcome, over all streams so far."""
        with self._lock:
            total = Counter(self._closed_outcomes)
            for stream in self._open.values():
                total.update(dict(stream.outcomes))
        return dict(total)

    def statuses(self) -> tuple[StreamStatus, ...]:
        """Return the status of each open stream."""
        return tuple(stream.status() for stream in list(self._open.values()))

    def count_by_client(self) -> Counter[bytes]:
        """Return the number of open streams by session of the client."""
        return Counter(stream.owner for stream in list(self._open.values()))

    def answer(self, id: str, record: object, client: bytes = b"") -> JsonRecord:
        """Open a stream, or close it if the record is ``{"close": true}``.

        Opening a stream again with the same parameters changes nothing, so that a client can repeat the request after it lost
        the connection. The `memory` of the repeated request is ignored, and the grasp if its contacts have changed. If the
        client has used another server since then, as its proofs show, the stream is replaced by a new one.

        Args:
            id: id of the stream.
            record: its setup, or the request to close it.
            client: session of the client.

        Returns:
            The answer to the client.

        Raises:
            InvalidInput: the record is invalid, or an open stream with this id has other parameters.
            UnknownName: the hand is not served, or the stream to close is not open.
            RequestRefused: too many streams are open, at all or by this client, or the stream belongs to another client.
        """
        protocol.check_named_id(id, "stream")
        proof = None
        if isinstance(record, Mapping):
            record = dict(record)
            proof = record.pop("proof", None)
            if "close" in record:
                if fields.check_record(record, "", required=["close"])["close"] is not True:
                    raise InvalidInput("close", record["close"], "true")
                return self._close(id, client, proof)
        setup = read_setup(self._hands, record)
        replaced = self._open.get(id)
        if replaced is not None and replaced.is_owned(client, proof) and replaced.is_replaced(proof):
            self._end([replaced])
        with self._lock:
            existing = self._open.get(id)
            if existing is None:
                self._check_capacity(client)
                stream = ServerStream(id, setup, client, proof)
                self._on_open(stream)
                self._open[id] = stream
            elif not existing.is_owned(client, proof):
                raise RequestRefused("forbidden", f"stream {id} belongs to another client")
            elif type(existing.setup) is not type(setup) or not existing.setup.opens(setup):  # type: ignore[arg-type]
                raise InvalidInput("stream", id, "a new id: the open stream with this id has other parameters")
        joints = list(setup.hand.joint_names)
        answer = {"stream": id, "opened": existing is None, "idle": self.idle_timeout, "joints": joints}
        opened = existing or stream
        return {**answer, **({"epoch": opened.epoch.hex()} if opened.epoch else {"key": (opened.key or b"").hex()})}

    def setup(self, id: str) -> JsonRecord:
        """Return the setup of an open stream as a plain record, and the number of its last change of contacts. Nothing changes.

        Args:
            id: id of the stream.

        Raises:
            UnknownName: the stream is not open.
        """
        stream = self._open.get(id)
        if stream is None:
            raise UnknownName("stream", id, (), "the id of an open stream; `status` lists them")
        return {"stream": id, "joints": list(stream.setup.hand.joint_names), "setup": stream.setup.to_dict()}

    def _check_capacity(self, client: bytes) -> None:
        """Refuse a new stream of a client if too many are open."""
        own = sum(stream.owner == client for stream in self._open.values())
        if len(self._open) >= self._capacity:
            message = f"{len(self._open)} streams are open: no more are allowed"
        elif own >= self._client_capacity:
            message = f"this client has {own} open streams: no more are allowed"
        else:
            return
        raise RequestRefused("overloaded", message, self.idle_timeout)

    def close_of(self, client: bytes) -> None:
        """Close the streams of a client that has disconnected.

        Args:
            client: its session.
        """
        self._end([stream for stream in list(self._open.values()) if stream.owner == client])

    def expire(self, now: float) -> None:
        """Close the idle streams.

        Args:
            now: current time on the clock `time.perf_counter`, s.
        """
        self._end([stream for stream in list(self._open.values()) if now - stream.last_received > self.idle_timeout])

    def close(self) -> None:
        """Close all streams."""
        self._end(list(self._open.values()))

    def _close(self, id: str, client: bytes, proof: object) -> JsonRecord:
        """Close a stream and return its counts."""
        stream = self._open.get(id)
        if stream is None:
            raise UnknownName("stream", id, (), "the id of an open stream")
        if not stream.is_owned(client, proof):
            raise RequestRefused("forbidden", f"stream {id} belongs to another client")
        self._end([stream])
        return {"stream": id, "outcomes": dict(stream.outcomes), "skipped": stream.skipped}

    def _end(self, streams: list[ServerStream]) -> None:
        """Remove streams that are still open, and add up their counts."""
        for stream in streams:
            with self._lock:
                if self._open.get(stream.id) is not stream:
                    continue
                del self._open[stream.id]
            self._on_close(stream)
            with self._lock:
                self._closed_outcomes.update(stream.outcomes)
