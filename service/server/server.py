"""The server: Zenoh queries in, replies out, and an orderly end.

Zenoh's own thread does nothing but put a query into a lane: never a call to Zenoh, never a wait. Work (solve, distribute) and
what is quickly said (status, descriptions, wrong keys) have lanes of their own, so that work delays no status; a query that
finds no room goes to a third lane, which tells its sender so at once.

Each control stream has a thread of its own behind a ring of one state, which Zenoh fills without Python: a newer state takes
the place of one that nobody has looked at, so that no client, however fast, slow or dead, holds up another.
"""

from __future__ import annotations

import atexit
import gc
import json
import logging
import os
import signal
import sys
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from types import FrameType
from typing import Any

import zenoh
from zenoh.handlers import Callback

from graspforce.core.errors import ServiceError
from graspforce.hand.hand import Hand
from graspforce.service.server.fair_queue import FairQueue
from graspforce.service.server.request_handler import RequestHandler, ServerLimits
from graspforce.service.server.stream_channel import StreamChannel
from graspforce.service.server.stream_registry import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.reply import Reply
from graspforce.service.zenoh_session import DEFAULT_ADDRESS, build_configuration, describe_zenoh_error

log = logging.getLogger("graspforce.service")

_DEFAULTS: dict[str, Any] = {
    "mode": "peer",
    # A client that does not read its replies is cut off after this long, µs, so that it holds no worker for Zenoh's 5 s.
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,
    # A command that finds no room because its client does not read is dropped at once, µs: the next one is newer.
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
}
_ADMIN_CAPACITY = 256  # status and the like that may wait
_MAX_CLIENT_ID_BYTES = 64  # bytes by which a client's turn is told from others'
_IDLE_CHECK_FRACTION = 0.25  # of the idle time: how often streams are looked at
_GRACE = 5.0  # s to answer what waits when the server closes
_SWITCH_INTERVAL = 1e-4  # s: how often Python's threads take turns, so that a reply does not wait 5 ms behind another thread
_OVERLOADED = "the server has no room for more requests: ask again later"
_CLOSING = "the server is closing"


@dataclass(frozen=True, eq=False, slots=True)
class _QueuedQuery:
    """A query, the key it came for, and when, on the clock `time.perf_counter`."""

    key: str
    query: zenoh.Query
    received: float


@dataclass(frozen=True, slots=True)
class _CancelRequest:
    """That a plan is no longer wanted: it waits in line behind the plan's own query."""

    id: str


class Server:
    """Serves force problems and hands over Zenoh. A context manager; `start` and `close` do the same by hand.

    Attributes:
        id: what its liveliness token and its status call it.
        addresses: the Zenoh endpoints it listens on, once started.

    Args:
        hands: hands to serve, by name, by path of a description file, or loaded.
        listen: the Zenoh endpoint to listen on, port 0 for any free one; by default `tcp/127.0.0.1:7450`, or with a
            configuration file what that says.
        config: path of a Zenoh configuration file, which then says everything else too.
        workers: threads that solve.
        room: requests that may wait for them; beyond, ``overloaded`` for whoever has most waiting.
        limits: what is too large.

    Raises:
        UnknownName, ModelError: a hand that is not there or cannot be used.
        InvalidInput: two hands of one name, or the configuration file is none.
    """

    def __init__(
        self,
        hands: Sequence[str | os.PathLike[str] | Hand] = (),
        *,
        listen: str | None = None,
        config: str | os.PathLike[str] | None = None,
        solver_threads: int = 2,
        capacity: int = 256,
        limits: ServerLimits | None = None,
    ) -> None:
        self.id = uuid.uuid4().hex
        loaded = [hand if isinstance(hand, Hand) else Hand.load(hand) for hand in hands]
        self._limits = limits or ServerLimits()
        self._handler = RequestHandler(
            loaded,
            server=self.id,
            queue_length=lambda: len(self._work_queue),
            limits=self._limits,
            on_open=self._open_channel,
            on_close=lambda stream: self._channels.pop(stream.id).close(),
            publish=self._publish,
        )
        self._channels: dict[str, StreamChannel] = {}
        self._listen = listen or (None if config is not None else DEFAULT_ADDRESS)
        endpoint: dict[str, Any] = {} if self._listen is None else {"listen/endpoints": [self._listen]}
        if self._listen is not None and self._listen.endswith(":0"):
            endpoint["adminspace/enabled"] = True  # only Zenoh itself knows which port it got
        self._config = build_configuration(config, _DEFAULTS, endpoint)
        self._solver_threads, self._capacity = solver_threads, capacity
        self._session: zenoh.Session | None = None

    def __enter__(self) -> Server:
        self.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def start(self) -> None:
        """Begin to serve.

        Raises:
            ServiceError: cannot listen on the address: it is taken, or it is none.
        """
        try:
            session = zenoh.open(self._config)
        except zenoh.ZError as error:
            raise ServiceError(
                f"cannot listen on {self._listen or 'the configured address'}: {describe_zenoh_error(error)}"
            ) from None
        self._session = session
        self.addresses = _addresses(session, self._config)
        self._work_queue: FairQueue[_QueuedQuery] = FairQueue(
            "work", self._answer, threads=self._solver_threads, capacity=self._capacity
        )
        self._admin_queue: FairQueue[_QueuedQuery | _CancelRequest] = FairQueue(
            "desk", self._handle_admin, capacity=_ADMIN_CAPACITY
        )
        self._refusal_queue: FairQueue[_QueuedQuery] = FairQueue("refusals", partial(self._refuse, "overloaded", _OVERLOADED))
        self._declared: list[Any] = [
            self._declare(session, key, partial(self._receive, self._work_queue if _is_work(key) else self._admin_queue, key))
            for key in self._handler.keys
        ]
        self._declared.append(self._declare(session, "hands/**", self._receive_unknown_hand, complete=False))
        self._declared.append(self._declare(session, "streams/*", self._stream))
        for key in self._handler.plan_keys:
            self._declared.append(self._declare(session, key, partial(self._receive, self._admin_queue, key)))
        cancel = Callback(self._cancel, indirect=False)
        self._declared.append(session.declare_subscriber(f"{protocol.PREFIX}/plans/*/cancel", cancel))
        asker = Callback(self._cancel_on_disconnect, indirect=False)
        self._declared.append(session.liveliness().declare_subscriber(f"{protocol.PREFIX}/plans/*/asker", asker))
        self._closing = threading.Event()
        self._idle_thread = threading.Thread(target=self._expire, name="idle-streams", daemon=True)
        self._idle_thread.start()
        self._token = session.liveliness().declare_token(f"{protocol.PREFIX}/alive/{self.id}")
        atexit.register(self.close)  # a script that forgets to must not hang in Zenoh's own end

    def close(self, grace: float = _GRACE) -> None:
        """Stop to serve, in order: take nothing new in, answer what waits, say goodbye. A second call does nothing.

        Args:
            grace: how long to wait for answers that are being worked on, s. What is not begun by then is refused.
        """
        session, deadline = self._session, time.monotonic() + grace
        if session is None:
            return
        while self._declared:
            self._declared.pop().undeclare()
        self._handler.plans.stop()
        left = [*self._work_queue.close(deadline), *self._admin_queue.close(deadline)]
        for arrival in left:
            if isinstance(arrival, _QueuedQuery):
                self._refuse("overloaded", _CLOSING, arrival)
        self._handler.plans.close(deadline)
        for arrival in self._refusal_queue.close(deadline + 1.0):
            self._refuse("overloaded", _CLOSING, arrival)
        self._closing.set()
        self._idle_thread.join()
        self._handler.streams.close()
        self._session = None
        self._token.undeclare()
        session.close()
        atexit.unregister(self.close)

    def _declare(
        self, session: zenoh.Session, key: str, on_query: Callable[[zenoh.Query], None], complete: bool = True
    ) -> zenoh.Queryable[None]:
        # complete: where several servers serve a key, Zenoh asks one of them. What is not is asked where no server has the key.
        return session.declare_queryable(f"{protocol.PREFIX}/{key}", Callback(on_query, indirect=False), complete=complete)

    def _receive(self, queue: FairQueue[Any], key: str, query: zenoh.Query) -> None:
        """What Zenoh's receiving thread does with a query."""
        arrival = _QueuedQuery(key, query, time.perf_counter())
        rejected = queue.offer(
            arrival, _client_id(query) if queue is self._work_queue else b""
        )  # the desk is quick, and keeps the order
        if rejected is not None:
            self._refusal_queue.offer(rejected)

    def _receive_unknown_hand(self, query: zenoh.Query) -> None:
        """What it does with a query for any hand: those that are served have a queryable of their own."""
        key = str(query.key_expr).removeprefix(f"{protocol.PREFIX}/")
        if key not in (*self._handler.keys, *self._handler.plan_keys) and "*" not in key:
            self._receive(self._admin_queue, key, query)

    def _stream(self, query: zenoh.Query) -> None:
        """What it does with a query to open or close a stream."""
        key = str(query.key_expr).removeprefix(f"{protocol.PREFIX}/")
        if "*" not in key:
            self._receive(self._work_queue, key, query)

    def _cancel(self, sample: zenoh.Sample) -> None:
        """What it does with the word that a plan is not wanted."""
        self._admin_queue.offer(_CancelRequest(str(sample.key_expr).split("/")[-2]))

    def _cancel_on_disconnect(self, sample: zenoh.Sample) -> None:
        """What it does when one who waits for a plan has come or gone."""
        if sample.kind == zenoh.SampleKind.DELETE:
            self._cancel(sample)

    def _publish(self, id: str, reply: Reply) -> None:
        """How far a plan is; dropped where nobody reads fast enough."""
        assert self._session is not None  # plans end before it
        try:
            self._session.put(
                f"{protocol.PREFIX}/plans/{id}/progress",
                reply.payload,
                encoding=reply.encoding,
                congestion_control=zenoh.CongestionControl.DROP,
            )
        except zenoh.ZError as error:
            log.warning("the progress of plan %s could not be sent: %s", id, describe_zenoh_error(error))

    def _open_channel(self, stream: ServerStream) -> None:
        assert self._session is not None  # only a query can open a stream
        self._channels[stream.id] = StreamChannel(self._session, stream)

    def _expire(self) -> None:
        while not self._closing.wait(_IDLE_CHECK_FRACTION * self._limits.idle_timeout):
            self._handler.streams.expire(time.perf_counter())

    def _handle_admin(self, item: _QueuedQuery | _CancelRequest) -> None:
        if isinstance(item, _CancelRequest):
            self._handler.plans.cancel(item.id)
        elif item.key in self._handler.plan_keys:
            self._plan(item)
        else:
            self._answer(item)

    def _plan(self, arrival: _QueuedQuery) -> None:
        query, key = arrival.query, arrival.key

        def answer(reply: Reply) -> None:
            with query:
                _send(query, key, reply)

        self._handler.plans.begin(key, *_read_query(query), answer, received=arrival.received)

    def _answer(self, arrival: _QueuedQuery) -> None:
        with arrival.query as query:
            _send(query, arrival.key, self._handler.answer(arrival.key, *_read_query(query), received=arrival.received))

    def _refuse(self, code: str, message: str, arrival: _QueuedQuery) -> None:
        with arrival.query as query:
            _send(query, arrival.key, self._handler.refuse(arrival.key, *_read_query(query), code=code, message=message))


def serve(
    hands: Sequence[str | os.PathLike[str] | Hand] = (),
    *,
    listen: str | None = None,
    config: str | os.PathLike[str] | None = None,
    on_ready: Callable[[Server], None] | None = None,
    grace: float = _GRACE,
) -> None:
    """Serve until SIGINT (Ctrl-C) or SIGTERM, then close in order; a second signal does not wait for answers. Main thread only.

    Args:
        hands, listen, config: as in `Server`.
        on_ready: called with the server once it serves.
        grace: how long to wait at the end for answers that are being worked on, s.

    Raises:
        UnknownName, ModelError, InvalidInput: as `Server`.
        ServiceError: cannot listen on the address.
    """
    stop = threading.Event()

    def on_signal(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    server = Server(hands, listen=listen, config=config)
    previous = {number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    turns = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    try:
        server.start()
        gc.collect()
        gc.freeze()  # what is loaded stays: to look through all of it takes 70 ms, and no stream gets a command meanwhile
        if on_ready is not None:
            on_ready(server)
        stop.wait()
    finally:
        stop.set()
        try:
            server.close(grace)
        except KeyboardInterrupt:
            server.close(grace=0.0)
        sys.setswitchinterval(turns)
        gc.unfreeze()
        for number, handler in previous.items():
            signal.signal(number, handler)


def _is_work(key: str) -> bool:
    return key == "solve" or key.endswith(("/distribute", "/control"))


def _client_id(query: zenoh.Query) -> bytes:
    """Who asks, by the query's attachment: Zenoh itself does not say. All who say nothing are one."""
    attachment = query.attachment
    return b"" if attachment is None else attachment.to_bytes()[:_MAX_CLIENT_ID_BYTES]


def _read_query(query: zenoh.Query) -> tuple[bytes, str | None]:
    payload, encoding = query.payload, query.encoding
    return b"" if payload is None else payload.to_bytes(), None if encoding is None else str(encoding)


def _send(query: zenoh.Query, key: str, reply: Reply) -> None:
    try:
        if reply.ok:
            query.reply(f"{protocol.PREFIX}/{key}", reply.payload, encoding=reply.encoding)
        else:
            query.reply_err(reply.payload, encoding=reply.encoding)
    except zenoh.ZError as error:
        log.warning("the reply to a request to %s could not be sent: %s", key, describe_zenoh_error(error))


def _addresses(session: zenoh.Session, config: zenoh.Config) -> tuple[str, ...]:
    """The endpoints that a session listens on."""
    for reply in session.get(f"@/{session.zid()}/*", timeout=1.0):
        if reply.ok is not None:
            return tuple(json.loads(reply.ok.payload.to_bytes())["locators"])
    endpoints = json.loads(config.get_json("listen/endpoints"))
    return tuple(endpoints if isinstance(endpoints, list) else endpoints["peer"])
