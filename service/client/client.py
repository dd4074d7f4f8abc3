"""The client: asks a server over Zenoh, and says which of four things went wrong when it gets no answer."""

from __future__ import annotations

import itertools
import os
import time
import uuid
import weakref
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

import zenoh
from zenoh.handlers import RingChannel

from graspforce.control import ControlSettings
from graspforce.core import arrays, fields
from graspforce.core.errors import (
    InvalidInput,
    NoServer,
    RequestRefused,
    ServiceError,
    ServiceTimeout,
)
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution
from graspforce.grasp.grasp import Grasp
from graspforce.planning import Plan, PlanFailure, ProgressCallback
from graspforce.planning.moves import Move
from graspforce.service.client.replies import decode_answer, decode_error, make_unreadable_error, parse_record, report_progress
from graspforce.service.client.stream import Stream
from graspforce.service.client.watchdog import Watchdog
from graspforce.service.client.zenoh_connection import ZenohConnection
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import RemoteCommand, read_command
from graspforce.service.wire.control_records import DEFAULT_VALIDITY, ControlRequest, StreamSetup
from graspforce.service.wire.distribute_records import DistributeRequest
from graspforce.service.wire.plan_records import read_answer, write_move
from graspforce.service.wire.protocol import Envelope
from graspforce.service.wire.status_records import ServerStatus
from graspforce.service.zenoh_session import DEFAULT_ADDRESS, build_configuration

# A server that comes back is found soon; a state that finds no room is dropped at once, µs: the next one is newer.
_DEFAULTS: dict[str, Any] = {
    "mode": "client",
    "connect/timeout_ms": 0,
    "connect/retry": {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 2},
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
}

_CODECS = {"msgpack": protocol.MSGPACK, "json": protocol.JSON}
_ALIVE_KEY = f"{protocol.PREFIX}/alive"
_PLAN_BUDGET = 10.0  # s: by default what planning may take
_PLAN_TRANSFER_TIME = 5.0  # s beyond its budget that the answer may take: a plan is some hundred kilobytes


class Client:
    """A client of the service. A context manager; safe to use from several threads. Nothing is asked twice by itself.

    Every request raises

    - `NoServer`: nobody answered, and no server is alive;
    - `ServiceTimeout`: a server is there, its answer did not come in time;
    - `RequestRefused`: the server would not do the work: overloaded, past its deadline, too large, not permitted;
    - `ErrorReply`: the server's own error record: ``invalid``, ``unknown`` or ``internal``.

    A server that comes back is found again by itself, within about a second.

    Args:
        connect: the server's Zenoh endpoint; by default `tcp/127.0.0.1:7450`, or with a configuration file what that says.
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
        self._timeout = arrays.check_number(timeout, "timeout", above=0.0)
        self._codec = _CODECS[fields.check_choice(encoding, "encoding", list(_CODECS))]
        self._name = uuid.uuid4().bytes  # by which the server tells its turn from others'
        self._sequence = itertools.count(1)
        self._streams: weakref.WeakSet[Stream] = weakref.WeakSet()
        self._address = connect or ("the configured address" if config is not None else DEFAULT_ADDRESS)
        milliseconds = max(round(self._timeout * 1e3), 1)
        defaults = {**_DEFAULTS, "transport/unicast/open_timeout": milliseconds}
        endpoint = {} if config is not None and connect is None else {"connect/endpoints": [self._address]}
        settings = build_configuration(config, defaults, endpoint)
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
        """The contact forces that hold the object at least cost, as `graspforce.force.solver`. Infeasible is an answer.

        Args:
            problem: a force problem, or the record of one.
            backend: the solver's name; by default the server's choice.
            budget: how long an answer is of use, s: later it is refused. By default the timeout.
            timeout: how long to wait, s; by default the client's.
        """
        record = problem.to_dict() if isinstance(problem, ForceProblem) else problem
        return parse_record(Solution.from_dict, self.query("solve", record, backend=backend, budget=budget, timeout=timeout))

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
        key = f"{protocol.hand_key(hand)}/distribute"
        return parse_record(Solution.from_dict, self.query(key, record, backend=backend, budget=budget, timeout=timeout))

    def control(self, request: ControlRequest, *, budget: float | None = None, timeout: float | None = None) -> RemoteCommand:
        """One control step: what the motors are to do for a state, with the force problem's certified answer.

        Args:
            request: the hold, the state and the desired motion; its ``memory`` is the last answer's, to go on from there.
            budget, timeout: as in `solve`.
        """
        key = f"{protocol.hand_key(request.grasp.hand.name)}/control"
        record = self.query(key, request.to_dict(), budget=budget, timeout=timeout)
        try:
            return read_command(request.grasp, record)
        except InvalidInput as unreadable:
            raise make_unreadable_error(unreadable) from None

    def open_stream(
        self,
        grasp: Grasp,
        settings: ControlSettings | None = None,
        *,
        validity: float = DEFAULT_VALIDITY,
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
        setup = StreamSetup(grasp, settings or ControlSettings(), validity)
        stream = Stream(
            id,
            setup,
            watchdog=watchdog or Watchdog(),
            codec=self._codec,
            timeout=self._timeout,
            query=partial(self.query, f"streams/{id}"),
            connect=partial(ZenohConnection, self._session, f"{protocol.PREFIX}/streams/{id}", self._codec),
        )
        self._streams.add(stream)
        return stream

    def plan(
        self,
        move: Move,
        *,
        budget: float = _PLAN_BUDGET,
        progress: ProgressCallback | None = None,
        id: str | None = None,
    ) -> Plan | PlanFailure:
        """The fastest move, as `move.plan`: the same record, or why there is none. Why it cannot be is an answer, not an error.

        The plan is stopped where this ends without it: by an error, by Ctrl-C, with the process.

        Args:
            move: what to plan, for a hand of `hands`.
            budget: s after which the best plan so far is the answer.
            progress: called with how far it is, in this thread; returns False to stop, and then the answer is the best plan so
                far.
            id: by which another client may follow and cancel it; by default made up.
        """
        hand, id = move.task.hand, uuid.uuid4().hex if id is None else protocol.check_plan_id(id)
        record = {**write_move(move), "id": id}
        assert hand is not None  # without, there is no such record
        asked, key = f"{protocol.hand_key(hand.name)}/plan", f"{protocol.PREFIX}/plans/{id}"
        timeout = arrays.check_number(budget, "budget", above=0.0) + max(self._timeout, _PLAN_TRANSFER_TIME)
        sequence, payload = self._encode_request(record, budget=budget)
        token = self._session.liveliness().declare_token(f"{key}/asker")
        try:
            progress_samples = self._session.declare_subscriber(f"{key}/progress", RingChannel(1))
            try:
                replies = report_progress(
                    self._send_query(asked, payload, timeout), progress_samples, progress, partial(self.cancel, id)
                )
                answer = self._first_answer(asked, replies, sequence, timeout)
            finally:
                progress_samples.undeclare()
        finally:
            token.undeclare()
        return parse_record(partial(read_answer, move), answer)

    def cancel(self, id: str) -> None:
        """Stop a plan, whoever asked for it; its answer is the best so far. To stop what is not under way does nothing.

        Args:
            id: the plan's.
        """
        self._session.put(f"{protocol.PREFIX}/plans/{protocol.check_plan_id(id)}/cancel", b"")

    def hand(self, name: str) -> dict[str, Any]:
        """A hand's description: fingers, joints, limits, frames."""
        return parse_record(dict, self.query(protocol.hand_key(name), {}))

    def hands(self) -> tuple[str, ...]:
        """The names of the hands that are served."""
        return self.status().hands

    def status(self) -> ServerStatus:
        """How the server does."""
        return parse_record(ServerStatus.from_dict, self.query("status", {}))

    def servers(self) -> tuple[str, ...]:
        """The ids of the servers that are alive; none of them is no error."""
        found: list[str] = []
        for reply in self._session.liveliness().get(f"{_ALIVE_KEY}/*", timeout=self._timeout):
            if reply.ok is None:
                raise ServiceTimeout(f"{self._address} did not say within {self._timeout:g} s which servers are alive")
            found.append(str(reply.ok.key_expr).removeprefix(f"{_ALIVE_KEY}/"))
        return tuple(sorted(found))

    def query(
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
        timeout = self._timeout if timeout is None else arrays.check_number(timeout, "timeout", above=0.0)
        sequence, payload = self._encode_request(record, budget=timeout if budget is None else budget, backend=backend)
        return self._first_answer(key, self._send_query(key, payload, timeout), sequence, timeout)

    def _encode_request(self, record: Mapping[str, Any], *, budget: float, backend: str | None = None) -> tuple[int, bytes]:
        """A request's number, and its bytes."""
        sequence = next(self._sequence)
        return sequence, protocol.encode(Envelope(sequence, budget, backend).wrap(record), self._codec)

    def _send_query(self, key: str, payload: bytes, timeout: float) -> zenoh.Handler[zenoh.Reply]:
        return self._session.get(
            f"{protocol.PREFIX}/{key}",
            payload=payload,
            encoding=self._codec,
            attachment=self._name,
            timeout=timeout,
            # Without consolidation an answer is handed on as it comes, not when all who might answer have done so.
            consolidation=zenoh.ConsolidationMode.NONE,
        )

    def _first_answer(self, key: str, replies: Iterable[zenoh.Reply], sequence: int, timeout: float) -> dict[str, Any]:
        """The first of the replies that is an answer; the error that says why there is none."""
        failure: ServiceError | None = None
        for reply in replies:
            if reply.ok is not None:
                return decode_answer(reply.ok, sequence)
            assert reply.err is not None  # a reply is one or the other
            # Where several servers are asked, that one of them does not know a hand says nothing of the others.
            if failure is None or getattr(failure, "code", "") == "unknown":
                failure = decode_error(reply.err, f"no answer within {timeout:g} s")
        if failure is not None:
            raise failure
        if not self.servers():
            raise NoServer(f"no server is alive at {self._address}")
        raise RequestRefused(
            "not_permitted", f"a server is alive, but {key} got no answer: not served, not permitted, or cut off"
        )
