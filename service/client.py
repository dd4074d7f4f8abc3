"""The client: asks a server over Zenoh, and says which of four things went wrong when it gets no answer."""

from __future__ import annotations

import contextlib
import itertools
import os
import time
import uuid
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any, TypeVar

import zenoh
from zenoh.handlers import RingChannel

from graspforce import arrays, fields
from graspforce.control import ControlSettings
from graspforce.errors import ErrorReply, InvalidInput, NoServer, Refused, ServiceError, ServiceTimeout, shown
from graspforce.hold import Hold
from graspforce.planning import Plan, Refusal, Watch
from graspforce.planning.move import Move
from graspforce.planning.progress import goes_on
from graspforce.problem import ForceProblem
from graspforce.service import wire
from graspforce.service.commands import RemoteCommand, read_command
from graspforce.service.control_records import VALIDITY, ControlRequest, StreamOpening
from graspforce.service.plan_records import read_answer, read_progress, write_move
from graspforce.service.records import DistributeRequest, ServerStatus
from graspforce.service.session import DEFAULT_ADDRESS, configuration, reason
from graspforce.service.stream import Stream
from graspforce.service.watchdog import Watchdog
from graspforce.service.wire import Envelope
from graspforce.solution import Solution

T = TypeVar("T")

# A server that comes back is found soon; a state that finds no room is dropped at once, µs: the next one is newer.
_DEFAULTS: dict[str, Any] = {
    "mode": "client",
    "connect/timeout_ms": 0,
    "connect/retry": {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 2},
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
}

_CODECS = {"msgpack": wire.MSGPACK, "json": wire.JSON}
_ALIVE = f"{wire.PREFIX}/alive"
_PLANNING = 10.0  # s: by default what planning may take
_ANSWERING = 5.0  # s beyond its budget that the answer may take: a plan is some hundred kilobytes
_LOOK = 0.01  # s between looks at what has come about a plan


class Client:
    """A client of the service. A context manager; safe to use from several threads. Nothing is asked twice by itself.

    Every request raises

    - `NoServer`: nobody answered, and no server is alive;
    - `ServiceTimeout`: a server is there, its answer did not come in time;
    - `Refused`: the server would not do the work: overloaded, past its deadline, too large, not permitted;
    - `ErrorReply`: the server's own error record: ``invalid``, ``unknown`` or ``internal``.

    A server that comes back is found again by itself, within about a second.

    Args:
        connect: the server's Zenoh endpoint; by default `tcp/127.0.0.1:7447`, or with a configuration file what that says.
        config: path of a Zenoh configuration file, which then says everything else too.
        timeout: how long a request waits for its answer, s.
        encoding: "msgpack" or "json".

    Raises:
        NoServer: nobody listens there; said at once.
        ServiceTimeout: somebody listens, but does not answer within the time.
        InvalidInput: an argument that is not allowed.
    """

    def __init__(
        self,
        connect: str | None = None,
        *,
        config: str | os.PathLike[str] | None = None,
        timeout: float = 1.0,
        encoding: str = "msgpack",
    ) -> None:
        self._timeout = arrays.number(timeout, "timeout", above=0.0)
        self._codec = _CODECS[fields.choice(encoding, "encoding", list(_CODECS))]
        self._name = uuid.uuid4().bytes  # by which the server tells its turn from others'
        self._sequence = itertools.count(1)
        self._streams: weakref.WeakSet[Stream] = weakref.WeakSet()
        self._address = connect or ("the configured address" if config is not None else DEFAULT_ADDRESS)
        milliseconds = max(round(self._timeout * 1e3), 1)
        defaults = {**_DEFAULTS, "transport/unicast/open_timeout": milliseconds}
        endpoint = {} if config is not None and connect is None else {"connect/endpoints": [self._address]}
        settings = configuration(config, defaults, endpoint)
        start = time.monotonic()
        try:
            self._session = zenoh.open(settings)
        except zenoh.ZError:
            if time.monotonic() - start >= self._timeout:
                raise ServiceTimeout(f"no answer from {self._address} within {self._timeout:g} s of opening") from None
            raise NoServer(f"no server at {self._address}: nobody there takes a Zenoh connection") from None

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the streams and the session. A second call does nothing; a script that forgets it ends all the same."""
        for stream in list(self._streams):
            stream.close()
        self._session.close()

    def solve(
        self,
        problem: ForceProblem | Mapping[str, Any],
        *,
        backend: str | None = None,
        budget: float | None = None,
        timeout: float | None = None,
    ) -> Solution:
        """The contact forces that hold the object at least cost, as `graspforce.solve`. Infeasible is an answer.

        Args:
            problem: a force problem, or the record of one.
            backend: the solver's name; by default the server's choice.
            budget: how long an answer is of use, s: later it is refused. By default the timeout.
            timeout: how long to wait, s; by default the client's.
        """
        record = problem.to_dict() if isinstance(problem, ForceProblem) else problem
        return _typed(Solution.from_dict, self.ask("solve", record, backend=backend, budget=budget, timeout=timeout))

    def distribute(
        self,
        hand: str,
        request: DistributeRequest | Mapping[str, Any],
        *,
        backend: str | None = None,
        budget: float | None = None,
        timeout: float | None = None,
    ) -> Solution:
        """The contact forces and motor torques with which a hand holds the object.

        Args:
            hand: the hand's name, one of `hands`.
            request: posture, object, contacts and wrench; or their record.
            backend, budget, timeout: as in `solve`.
        """
        record = request.to_dict() if isinstance(request, DistributeRequest) else request
        key = f"{wire.hand_key(hand)}/distribute"
        return _typed(Solution.from_dict, self.ask(key, record, backend=backend, budget=budget, timeout=timeout))

    def control(self, request: ControlRequest, *, budget: float | None = None, timeout: float | None = None) -> RemoteCommand:
        """One control step: what the motors are to do for a state, with the force problem's certified answer.

        Args:
            request: the hold, the state and the desired motion; its ``memory`` is the last answer's, to go on from there.
            budget, timeout: as in `solve`.
        """
        key = f"{wire.hand_key(request.hold.hand.name)}/control"
        record = self.ask(key, request.to_dict(), budget=budget, timeout=timeout)
        try:
            return read_command(request.hold, record)
        except InvalidInput as unreadable:
            raise _unreadable(unreadable) from None

    def open_stream(
        self,
        hold: Hold,
        settings: ControlSettings | None = None,
        *,
        validity: float = VALIDITY,
        watchdog: Watchdog | None = None,
    ) -> Stream:
        """Open a control stream: the server's `ObjectController` at the other end of a wire. Close it, or use it in a ``with``.

        Args:
            hold: the hand, the object, and which fingers touch it where; the server must serve the hand.
            settings: of the controller; by default its own.
            validity: how old a command may be, s, counted from when the state that it answers was sent.
            watchdog: what the motors get while commands fail to come; by default `Watchdog()`.
        """
        id = uuid.uuid4().hex
        opening = StreamOpening(hold, settings or ControlSettings(), validity)
        stream = Stream(
            id,
            opening,
            watchdog=watchdog or Watchdog(),
            codec=self._codec,
            timeout=self._timeout,
            ask=partial(self.ask, f"streams/{id}"),
            connect=partial(_Link, self._session, f"{wire.PREFIX}/streams/{id}", self._codec),
        )
        self._streams.add(stream)
        return stream

    def plan(
        self,
        move: Move,
        *,
        budget: float = _PLANNING,
        progress: Watch | None = None,
        id: str | None = None,
    ) -> Plan | Refusal:
        """The fastest move, as `move.plan`: the same record, or why there is none. Why it cannot be is an answer, not an error.

        The plan is stopped where this ends without it: by an error, by Ctrl-C, with the process.

        Args:
            move: what to plan, for a hand of `hands`.
            budget: s after which the best plan so far is the answer.
            progress: called with how far it is, in this thread; returns False to stop, and then the answer is the best plan so
                far.
            id: by which another client may follow and cancel it; by default made up.
        """
        hand, id = move.task.hand, uuid.uuid4().hex if id is None else wire.plan_id(id)
        record = {**write_move(move), "id": id}
        assert hand is not None  # without, there is no such record
        asked, key = f"{wire.hand_key(hand.name)}/plan", f"{wire.PREFIX}/plans/{id}"
        timeout = arrays.number(budget, "budget", above=0.0) + max(self._timeout, _ANSWERING)
        sequence, payload = self._packed(record, budget=budget)
        token = self._session.liveliness().declare_token(f"{key}/asker")
        try:
            heard = self._session.declare_subscriber(f"{key}/progress", RingChannel(1))
            try:
                replies = _with_progress(self._get(asked, payload, timeout), heard, progress, partial(self.cancel, id))
                answer = self._first(asked, replies, sequence, timeout)
            finally:
                heard.undeclare()
        finally:
            token.undeclare()
        return _typed(partial(read_answer, move), answer)

    def cancel(self, id: str) -> None:
        """Stop a plan, whoever asked for it; its answer is the best so far. To stop what is not under way does nothing.

        Args:
            id: the plan's.
        """
        self._session.put(f"{wire.PREFIX}/plans/{wire.plan_id(id)}/cancel", b"")

    def hand(self, name: str) -> dict[str, Any]:
        """A hand's description: fingers, joints, limits, frames."""
        return _typed(dict, self.ask(wire.hand_key(name), {}))

    def hands(self) -> tuple[str, ...]:
        """The names of the hands that are served."""
        return self.status().hands

    def status(self) -> ServerStatus:
        """How the server does."""
        return _typed(ServerStatus.from_dict, self.ask("status", {}))

    def servers(self) -> tuple[str, ...]:
        """The ids of the servers that are alive; none of them is no error."""
        found: list[str] = []
        for reply in self._session.liveliness().get(f"{_ALIVE}/*", timeout=self._timeout):
            if reply.ok is None:
                raise ServiceTimeout(f"{self._address} did not say within {self._timeout:g} s which servers are alive")
            found.append(str(reply.ok.key_expr).removeprefix(f"{_ALIVE}/"))
        return tuple(sorted(found))

    def ask(
        self,
        key: str,
        record: Mapping[str, Any],
        *,
        backend: str | None = None,
        budget: float | None = None,
        timeout: float | None = None,
    ) -> dict[str, Any]:
        """The service's whole record for a request, with ``server_seconds`` and ``sequence``.

        Args:
            key: what is asked, below the prefix: "solve", "status", ….
            record: the request, without its envelope.
            backend, budget, timeout: as in `solve`.
        """
        timeout = self._timeout if timeout is None else arrays.number(timeout, "timeout", above=0.0)
        sequence, payload = self._packed(record, budget=timeout if budget is None else budget, backend=backend)
        return self._first(key, self._get(key, payload, timeout), sequence, timeout)

    def _packed(self, record: Mapping[str, Any], *, budget: float, backend: str | None = None) -> tuple[int, bytes]:
        """A request's number, and its bytes."""
        sequence = next(self._sequence)
        return sequence, wire.encode(Envelope(sequence, budget, backend).put_on(record), self._codec)

    def _get(self, key: str, payload: bytes, timeout: float) -> zenoh.Handler[zenoh.Reply]:
        return self._session.get(
            f"{wire.PREFIX}/{key}",
            payload=payload,
            encoding=self._codec,
            attachment=self._name,
            timeout=timeout,
            # Without consolidation an answer is handed on as it comes, not when all who might answer have done so.
            consolidation=zenoh.ConsolidationMode.NONE,
        )

    def _first(self, key: str, replies: Iterable[zenoh.Reply], sequence: int, timeout: float) -> dict[str, Any]:
        """The first of the replies that is an answer; the error that says why there is none."""
        failure: ServiceError | None = None
        for reply in replies:
            if reply.ok is not None:
                return _answer(reply.ok, sequence)
            assert reply.err is not None  # a reply is one or the other
            # Where several servers are asked, that one of them does not know a hand says nothing of the others.
            if failure is None or getattr(failure, "code", "") == "unknown":
                failure = _failure(reply.err, f"no answer within {timeout:g} s")
        if failure is not None:
            raise failure
        if not self.servers():
            raise NoServer(f"no server is alive at {self._address}")
        raise Refused("not_permitted", f"a server is alive, but {key} got no answer: not served, not permitted, or cut off")


def _with_progress(
    replies: zenoh.Handler[zenoh.Reply], heard: zenoh.Subscriber[Any], progress: Watch | None, cancel: Callable[[], None]
) -> Iterator[zenoh.Reply]:
    """The replies as they come; meanwhile ``progress`` is told how far it is."""
    going = True
    while True:
        try:
            reply = replies.try_recv()
        except zenoh.ZError:  # nobody else will answer
            return
        if reply is not None:
            yield reply
            continue
        sample = heard.handler.try_recv()
        if sample is None:
            time.sleep(_LOOK)
        elif progress is not None and going:
            with contextlib.suppress(InvalidInput):  # of another program under the same id
                now = read_progress(wire.decode(sample.payload.to_bytes(), wire.codec(str(sample.encoding))))
                if not goes_on(progress(now)):
                    going = False
                    cancel()


class _Link:
    """A stream's way to its server over Zenoh, which lays the newest command into a ring of one without Python."""

    def __init__(self, session: zenoh.Session, key: str, codec: str) -> None:
        self._commands = session.declare_subscriber(f"{key}/command", RingChannel(1))
        self._take = self._commands.handler.try_recv
        drop = zenoh.CongestionControl.DROP
        self._states = session.declare_publisher(f"{key}/state", encoding=codec, congestion_control=drop)

    def send(self, payload: bytes) -> None:
        try:
            self._states.put(payload)
        except zenoh.ZError as error:
            raise ServiceError(f"the stream is closed: {reason(error)}") from None

    def receive(self) -> tuple[bytes, str] | None:
        try:
            sample = self._take()
        except zenoh.ZError:  # closed
            return None
        return None if sample is None else (sample.payload.to_bytes(), str(sample.encoding))

    def close(self) -> None:
        with contextlib.suppress(zenoh.ZError):  # a session that is closed has closed both
            self._commands.undeclare()
            self._states.undeclare()


def _failure(error: zenoh.ReplyError, late: str) -> ServiceError:
    """A reply that is no answer, as the exception to raise."""
    payload, encoding = error.payload.to_bytes(), str(error.encoding)
    if encoding not in _CODECS.values():  # Zenoh's own word
        return ServiceTimeout(late) if payload == b"Timeout" else ErrorReply("internal", f"Zenoh says {shown(payload)}", None)
    try:
        return wire.failure(wire.decode(payload, encoding))
    except InvalidInput as unreadable:
        return _unreadable(unreadable)


def _answer(sample: zenoh.Sample, sequence: int) -> dict[str, Any]:
    """The record of an answer, which must carry the number of its question."""
    try:
        record = wire.decode(sample.payload.to_bytes(), wire.codec(str(sample.encoding)))
    except InvalidInput as unreadable:
        raise _unreadable(unreadable) from None
    echo = record.get("sequence") if isinstance(record, dict) else None
    if echo != sequence:
        raise ErrorReply("internal", f"the answer carries the sequence {shown(echo)} where {sequence} was asked", "sequence")
    return dict(record)


def _typed(read: Callable[[Mapping[str, Any]], T], record: dict[str, Any]) -> T:
    """A server's record, without its envelope, as a typed one."""
    try:
        return read({name: value for name, value in record.items() if name not in ("sequence", "server_seconds")})
    except InvalidInput as unreadable:
        raise _unreadable(unreadable) from None


def _unreadable(error: InvalidInput) -> ErrorReply:
    return ErrorReply("internal", f"the server's answer could not be read: {error}", error.field or None)
