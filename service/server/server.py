"""The server on the network: Zenoh queries in, replies out, and a graceful shutdown.

| thread                   | work                                                                                |
|--------------------------|-------------------------------------------------------------------------------------|
| Zenoh's receiving thread | puts each query into a queue; it never waits and never calls Zenoh                  |
| those of the queues      | answer, begin or refuse requests by class (`graspforce.service.server.work_queues`) |
| one for each stream      | one control step for the newest state (`graspforce.service.server.stream_channel`)  |
| one for each active plan | waits for its planning process (`graspforce.service.server.plan_registry`)          |
| idle streams (one)       | closes streams without states, and ends the work of clients that have disconnected  |
| lease (one, of replicas) | gives up the streams after the process was frozen                                   |

With `worker_processes`, the threads of small and large requests wait for processes that do the work: Python runs one thread of
a process at a time, and a request in a thread would delay the streams. The streams stay in this process, to which their clients
connect: another process would add its own connection to each round trip.

The queues keep long work from delaying short answers, and serve clients in turn (`graspforce.service.server.fair_queue`). The
attachment of a query identifies its client (`graspforce.service.server.client_sessions`).
"""

from __future__ import annotations

import atexit
import contextlib
import dataclasses
import logging
import os
import queue
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path

import zenoh
from zenoh.handlers import Callback

from graspforce.core.errors import ServiceError
from graspforce.hand.hand import Hand
from graspforce.service.realtime_scheduling import ServerPriorities
from graspforce.service.recording.exchange import REQUEST, recorded
from graspforce.service.recording.recorder import Recorder
from graspforce.service.server.client_sessions import OTHERS, ClientSessions
from graspforce.service.server.configuration import REPLICA_LEASE, check_endpoints, server_configuration
from graspforce.service.server.deadline import Deadline
from graspforce.service.server.limits import ServerLimits
from graspforce.service.server.process_lease import ProcessLease
from graspforce.service.server.query_intake import QueryIntake
from graspforce.service.server.query_messages import matching_keys, read_query, send_reply
from graspforce.service.server.request_handler import MAX_PARSED_BYTES, RequestHandler
from graspforce.service.server.request_worker import RequestWorkers
from graspforce.service.server.server_load import ServerLoad
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.server.stream_channel import StreamChannel
from graspforce.service.server.stream_priorities import StreamPriorities
from graspforce.service.server.work_queues import (
    CancelRequest,
    CostClass,
    QueuedQuery,
    QueueOptions,
    WorkQueues,
)
from graspforce.service.wire import protocol
from graspforce.service.wire.reply import Reply
from graspforce.service.wire.status_records import ServerStatus
from graspforce.service.zenoh_session import describe_zenoh_error, find_addresses

log = logging.getLogger("graspforce.service")

_MAX_CANCEL_TRIES = 256  # of a cancellation that may be ahead of its plan
_IDLE_CHECK_FRACTION = 0.25  # period of the check for idle streams as a fraction of the idle timeout
_GRACE = 5.0  # s, to answer the waiting requests at the end
_PLANNERS_DELAY = 2.0  # s after the start, until the planning processes start
_RECORDING_TIME = 5.0  # s, to complete the recording; another process then writes the rest
_REFUSAL_TIME = 0.2  # s after the deadline of an end, to send refusals
_OVERLOADED = "the request queue is full: ask again later"
_CLOSING = protocol.CLOSING_MESSAGE


class Server:
    """Server of force problems, hands, control streams and plans over Zenoh.

    Use it as a context manager, or call `start` and `close`.

    Attributes:
        id: id of the server, in its liveliness token and its status.
        addresses: Zenoh endpoints at which it listens, after `start`.
        priorities: real-time priorities of its threads.

    Args:
        hands: hands to serve: names of shipped hands, paths of description files, or `Hand` objects.
        listen: Zenoh endpoint to listen on, with port 0 for any free port; by default ``tcp/127.0.0.1:7450``, or the endpoint
            of the configuration file.
        config: path of a Zenoh configuration file, JSON or JSON5; its settings replace graspforce's, except `listen`.
        solver_threads: number of threads that answer small requests.
        large_threads: number of threads that answer large requests (`graspforce.service.server.work_queues`).
        capacity: number of requests that may wait for each of them; beyond, the newest request of the busiest client is
            refused.
        limits: limits on requests, streams and plans; by default `ServerLimits()`.
        insecure: listen beyond this machine without TLS: any program in the network can then drive the hands.
        secure: directory of `graspforce secure init`: mutual TLS with access by role; `listen` is then ``tls/0.0.0.0:7450``.
        connect: Zenoh endpoints to connect to as well, such as that of a router. Clients of the router reach the server.
        worker_processes: answer small and large requests in processes, one for each thread, so that they do not delay streams.
        lease: time without a sign of life after which clients and routers give up the server, and the server its streams, s; by
            default `REPLICA_LEASE` with `connect`, otherwise Zenoh's 10 s, and the server keeps its streams.
        record: MCAP file in which to record requests, states and replies; an existing file is replaced. None for none.
        realtime: highest priority of the real-time scheduling of this process from `start` to `close`, from 1 to 49, on Linux;
            None for ordinary scheduling. Worker and planning processes stay ordinary.

    Raises:
        UnknownName: a hand does not exist.
        ModelError: a hand cannot be read.
        InvalidInput: two hands have the same name, the configuration file is invalid, or an endpoint beyond this machine has no
            TLS and `insecure` is false.
    """

    def __init__(
        self,
        hands: Sequence[str | os.PathLike[str] | Hand] = (),
        *,
        listen: str | None = None,
        config: str | os.PathLike[str] | None = None,
        solver_threads: int = 2,
        large_threads: int = 1,
        capacity: int = 256,
        limits: ServerLimits | None = None,
        insecure: bool = False,
        secure: str | os.PathLike[str] | None = None,
        connect: Sequence[str] = (),
        worker_processes: bool = False,
        lease: float | None = None,
        record: str | os.PathLike[str] | None = None,
        realtime: int | None = None,
    ) -> None:
        self.id = uuid.uuid4().hex
        self._hands = loaded = [hand if isinstance(hand, Hand) else Hand.load(hand) for hand in hands]
        self._limits = limits or ServerLimits()
        self._handler = RequestHandler(
            loaded,
            server=self.id,
            load=self.load,
            limits=self._limits,
            on_open=self._open_channel,
            on_close=self._close_channel,
            publish=self._publish,
        )
        self._channels: dict[str, StreamChannel] = {}
        lease = REPLICA_LEASE if lease is None and connect else lease
        self._lease = ProcessLease(lease, self._handler.streams.close)
        self._sessions = ClientSessions()
        self._listen = listen
        self._config, self._routers = server_configuration(config, listen, secure, connect, lease), tuple(connect)
        check_endpoints(self._config, insecure, secure is not None)
        self._queue_options = QueueOptions(solver_threads, large_threads, capacity, self._limits.queue_bytes)
        self._worker_processes = worker_processes
        self._workers: dict[CostClass, RequestWorkers] = {}
        self._recorder = None if record is None else Recorder(Path(record))
        self.priorities = ServerPriorities(realtime)
        self._stream_priorities = StreamPriorities(self.priorities, self._limits.realtime_states)
        self._session: zenoh.Session | None = None
        self._closing = threading.Event()

    def __enter__(self) -> Server:
        self.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def start(self) -> None:
        """Listen and serve in the background.

        Raises:
            ServiceError: the address is in use or invalid; the message names it.
            InvalidInput: the system does not permit real-time scheduling.
        """
        with contextlib.ExitStack() as undo:
            undo.callback(self.priorities.end)
            self.priorities.apply()
            session = self._open_session()
            undo.callback(session.close)
            if self._recorder is not None:
                self._recorder.start(self._hands, dataclasses.asdict(self._limits))  # OSError: the file cannot be written
            undo.pop_all()
        self._session = session
        self.addresses = find_addresses(session, self._config)
        if self._worker_processes:
            self._workers = self._queue_options.start_workers(self._hands, self._limits)
        self._lease.start()
        self._queues = WorkQueues(self._queue_options, self._answer, self._handle_plan, self._refuse_overload)
        keys, is_waking = (*self._handler.keys, *self._handler.plan_keys), lambda: self._lease.is_waking
        self._intake = QueryIntake(self._queues, self._sessions, self._limits, keys, is_waking)
        self._declared = self._intake.declare(session)
        self._closing.clear()
        listener = Callback(self._receive_transport, indirect=False)
        self._declared.append(session.info.declare_transport_events_listener(listener, history=True))
        self._idle_thread = threading.Thread(target=self._expire_streams, name="idle-streams", daemon=True)
        self._idle_thread.start()
        if self._worker_processes:
            self._handler.plans.start_processes(_PLANNERS_DELAY)
        self._token = session.liveliness().declare_token(f"{protocol.PREFIX}/alive/{self.id}")
        atexit.register(self.close)  # without it, a script that does not close would hang in Zenoh's cleanup

    def _open_session(self) -> zenoh.Session:
        """Open the Zenoh session.

        Raises:
            ServiceError: the address is in use or invalid.
        """
        try:
            with self.priorities.for_messages():
                return zenoh.open(self._config)
        except zenoh.ZError as error:
            address, reason = self._listen or "the configured address", describe_zenoh_error(error)
            hint = "; stop the other program, or listen on another port" if "in use" in reason else ""
            raise ServiceError(f"cannot listen on {address}: {reason}{hint}") from None

    def close(self, grace: float | Deadline = _GRACE) -> None:
        """Stop serving: leave the replicas, close the streams, answer the waiting requests. A second call does nothing.

        The last message of each stream is the error record ``closing``, so that its client opens it at another replica.

        Args:
            grace: time to wait for answers, s, or the deadline. Requests that are not begun by then are refused as ``closing``.
        """
        session, deadline = self._session, grace if isinstance(grace, Deadline) else Deadline(grace)
        if session is None:
            return
        self._token.undeclare()  # clients go to other replicas from now on
        while self._declared:
            self._declared.pop().undeclare()
        self._closing.set()
        self._lease.close()
        self._handler.plans.stop()
        self._handler.streams.close()
        for waiting in self._queues:
            for item in waiting.close(deadline):
                if isinstance(item, QueuedQuery):
                    self._refuse("closing", _CLOSING, item)
        for workers in self._workers.values():
            workers.close()  # this ends the work that is not finished
        self._handler.plans.close(deadline)
        for item in self._queues.refusals.close(deadline, extra=_REFUSAL_TIME):
            self._refuse("closing", _CLOSING, item)
        self._sessions.ended.put(None)
        self._idle_thread.join()
        self._session = None
        session.close()
        if self._recorder is not None:
            self._recorder.close(_RECORDING_TIME)
        self.priorities.end()
        atexit.unregister(self.close)

    def load(self) -> ServerLoad:
        """Return the load of the server, and why it cannot take work if it cannot. Any thread may call it."""
        if self._session is None or self._closing.is_set():
            return ServerLoad(problem="the server is closing" if self._session else "the server does not run")
        longest = self._queues.longest_work
        problem = f"a request has been in progress for {longest:.0f} s" if longest > self._limits.stall_time else None
        if self._session.is_closed():
            problem = "the Zenoh session is closed"
        where = (*self.addresses, *self._routers)
        return ServerLoad(self._queues.waiting, self._queues.waiting_bytes, self._queues.count_by_client(), problem, where)

    def begin_plan(self, key: str, payload: bytes, encoding: str | None, answer: Callable[[Reply], None]) -> None:
        """Begin to plan a move in a planning process, for a program in this process, and return at once.

        Args:
            key: key of the request after the prefix: ``hands/<hand>/plan`` or ``hands/<hand>/grasp``.
            payload: the encoded request.
            encoding: its Zenoh encoding; None for JSON.
            answer: called exactly once with the reply, from any thread. Invalid requests get an error record.
        """
        self._handler.plans.begin(key, payload, encoding, answer)

    def status(self) -> ServerStatus:
        """Return the status of the server: load, counts and latencies. Any thread may call it."""
        return self._handler.status()

    def reload_hand(self, hand: Hand) -> None:
        """Serve a changed hand in place of the one with its name. Open streams keep theirs until they are opened again.

        Args:
            hand: the hand.

        Raises:
            UnknownName: no hand of this name is served.
        """
        self._handler.replace_hand(hand)
        self._hands[:] = [hand if each.name == hand.name else each for each in self._hands]
        for workers in self._workers.values():
            workers.serve(tuple(self._hands))

    # ── on Zenoh's receiving thread ──────────────────────────────────────────────────────────────────────────────────────

    def _receive_transport(self, event: zenoh.TransportEvent) -> None:
        """Follow the sessions that are connected."""
        transport = event.transport
        follow = self._sessions.connect if event.kind == zenoh.SampleKind.PUT else self._sessions.disconnect
        follow(str(transport.zid), transport.whatami == zenoh.WhatAmI.ROUTER)

    # ── on the queues' threads ───────────────────────────────────────────────────────────────────────────────────────────

    def _handle_plan(self, item: QueuedQuery | CancelRequest) -> None:
        """Handle an item of the plan queue."""
        if isinstance(item, QueuedQuery):
            self._plan(item)
        elif not self._handler.plans.cancel(item.id) and len(self._queues.plans) and item.tries < _MAX_CANCEL_TRIES:
            self._queues.plans.offer(CancelRequest(item.id, item.tries + 1))

    def _plan(self, item: QueuedQuery) -> None:
        """Begin a plan, whose thread sends the reply."""
        query, key = item.query, item.key

        def answer(reply: Reply) -> None:
            with query:
                self._send(item, key, reply)

        self._handler.plans.begin(key, *read_query(query), answer, item.received, self._session_of(item))

    def _answer(self, item: QueuedQuery) -> None:
        """Answer a query, and one for several schemas with several replies."""
        with item.query:
            for key in matching_keys(item.key):
                self._send(item, key, self._reply(key, item))

    def _reply(self, key: str, item: QueuedQuery) -> Reply:
        """Return the reply to a query for a key, from a worker process if the query's class has them."""
        workers = None if key.startswith("streams/") else self._workers.get(item.cost)
        if workers is None:
            return self._handler.answer(key, *read_query(item.query), item.received, self._session_of(item))
        outcome, reply = workers.compute(key, *read_query(item.query), item.received, self._session_of(item))
        self._handler.count(key, outcome, time.perf_counter() - item.received)
        return reply

    def _session_of(self, item: QueuedQuery) -> bytes:
        """Return the session of a query's client, which may have been connecting when the query arrived."""
        return item.client.session or self._sessions.identify(item.client.name).session

    def _refuse_overload(self, item: QueuedQuery) -> None:
        """Refuse a query that is too large or that a full queue has rejected."""
        size = len(item.query.payload or b"")
        if size > self._limits.payload:
            message = f"the payload has {size} bytes: at most {self._limits.payload} are allowed"
            self._refuse("too_large", message, item)
            return
        self._refuse("overloaded", _OVERLOADED, item, self._queues.expected_wait(item))

    def _refuse(self, code: str, message: str, item: QueuedQuery, retry_after: float | None = None) -> None:
        """Refuse a query."""
        with item.query as query:
            payload, encoding = read_query(query, MAX_PARSED_BYTES)
            self._send(item, item.key, self._handler.refuse(item.key, payload, encoding, code, message, retry_after))

    def _send(self, item: QueuedQuery, key: str, reply: Reply) -> None:
        """Record a query and its reply for a key, and send the reply. So the opening of a stream is before its states."""
        if self._recorder is not None:
            self._recorder.offer(recorded(REQUEST, key, item.received, read_query(item.query), reply))
        send_reply(item.query, key, reply)

    # ── streams and plans ────────────────────────────────────────────────────────────────────────────────────────────────

    def _open_channel(self, stream: ServerStream) -> None:
        """Connect a new stream to the network."""
        assert self._session is not None  # only a query opens a stream
        priority = self._stream_priorities.open(stream.id, stream.setup.period)
        self._channels[stream.id] = StreamChannel(
            self._session, stream, lambda: self._lease.holds, self._recorder, priority=priority
        )

    def _close_channel(self, stream: ServerStream) -> None:
        """Disconnect a closed stream from the network."""
        self._channels.pop(stream.id).close(is_server_closing=self._closing.is_set())
        self._stream_priorities.close(stream.id)

    def _expire_streams(self) -> None:
        """Close idle streams, and end the work of clients that have disconnected, until the server closes."""
        while not self._closing.is_set():
            try:
                ended = self._sessions.ended.get(timeout=_IDLE_CHECK_FRACTION * self._limits.idle_timeout)
            except queue.Empty:
                ended = None
            if ended == OTHERS:  # a router has disconnected: its clients continue at another replica
                self._handler.streams.close_of(OTHERS)
            elif ended is not None and not self._sessions.is_connected(ended):
                self._queues.drop(ended)
                self._handler.plans.cancel_of(ended)
                self._handler.streams.close_of(ended)
            self._handler.streams.expire(time.perf_counter())
            self._queues.release_memory()

    def _publish(self, id: str, reply: Reply) -> None:
        """Publish the progress of a plan."""
        session = self._session
        if session is None:
            return
        key, drop = f"{protocol.PREFIX}/plans/{id}/progress", zenoh.CongestionControl.DROP
        try:
            session.put(key, reply.payload, encoding=reply.encoding, congestion_control=drop)
        except zenoh.ZError as error:
            log.warning("cannot publish the progress of plan %s: %s", id, describe_zenoh_error(error))
