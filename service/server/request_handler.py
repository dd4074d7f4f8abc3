"""Bytes in, bytes out: what the service answers, without a network. Every error becomes a reply."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

import graspforce
from graspforce.contact.contact import ContactSet
from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput, RequestRefused, UnknownName
from graspforce.force.problem import ForceProblem
from graspforce.force.solver import solve
from graspforce.grasp.grasp import check_contact_fingers
from graspforce.hand.hand import Hand
from graspforce.service.server.plan_registry import PlanRegistry
from graspforce.service.server.request_statistics import RequestStatistics
from graspforce.service.server.stream_registry import ServerStream, StreamRegistry, answer_control_request
from graspforce.service.wire import protocol
from graspforce.service.wire.control_records import ControlRequest
from graspforce.service.wire.distribute_records import DistributeRequest
from graspforce.service.wire.reply import Reply, describe_error, make_error_reply
from graspforce.service.wire.status_records import ServerStatus
from graspforce.service.workers.planning_worker import PlanningWorker

log = logging.getLogger("graspforce.service")

# What would make an infeasible problem feasible takes some forty solves. It is not worked out when the proof has not this much
# time, s, to be sent, nor for longer than this, s, while others wait, nor for problems with more entries in their constraint
# matrix than this.
_SEND_TIME = 0.1
_MAX_EXPLANATION_TIME = 1.0
_MAX_ENTRIES_TO_EXPLAIN = 100_000
_MAX_PARSED_BYTES = 64 * 2**10  # bytes of a request that is read for its sequence number alone


@dataclass(frozen=True, slots=True)
class ServerLimits:
    """What a server will work on. Beyond: the error ``too_large``.

    Args:
        payload: bytes of a request.
        contacts: contacts of a problem.
        numbers: entries of the problem's dense constraint matrix.
        streams: control streams that are open; beyond, ``overloaded``.
        plans: moves that are planned at once; beyond, ``overloaded``.
        planning: the largest budget of a plan, s.
        intervals: of a plan.
        idle: how long a control stream stays open without a state, s.
    """

    payload: int = 8 * 2**20
    contacts: int = 500
    matrix_entries: int = 5_000_000
    streams: int = 64
    plans: int = 2
    plan_budget: float = 60.0
    intervals: int = 500
    idle_timeout: float = 10.0


@dataclass(frozen=True, slots=True)
class _RequestOptions:
    """On what terms a request is worked on: with which solver, and until when on the clock `time.perf_counter`, s."""

    backend: str | None
    deadline: float


class RequestHandler:
    """Answers requests, from any thread.

    Args:
        hands: the hands to serve.
        server: the server's id, for its status.
        queued: says how many requests wait, for its status.
        limits: what is too large.
        opened, closed: called with each control stream that is opened or closed.
        publish: called with a plan's id and how far it is.

    Attributes:
        streams: the control streams that are open.
        plans: the plans under way; ``hands/<hand>/plan`` is asked of them, since nobody waits for a plan here.

    Raises:
        InvalidInput: two hands have one name, or a name that cannot stand in a key.
    """

    def __init__(
        self,
        hands: Sequence[Hand] = (),
        *,
        server: str = "",
        queue_length: Callable[[], int] = lambda: 0,
        limits: ServerLimits | None = None,
        on_open: Callable[[ServerStream], None] = lambda stream: None,
        on_close: Callable[[ServerStream], None] = lambda stream: None,
        publish: Callable[[str, Reply], None] = lambda id, reply: None,
    ) -> None:
        self._hands: dict[str, Hand] = {}
        for hand in hands:
            if hand.name in self._hands:
                raise InvalidInput("hands", hand.name, "of different names")
            self._hands[hand.name] = hand
        self._server, self._queue_length, self._limits = server, queue_length, limits or ServerLimits()
        capacity, idle_timeout = self._limits.streams, self._limits.idle_timeout
        self.streams = StreamRegistry(
            self._hands, capacity=capacity, idle_timeout=idle_timeout, on_open=on_open, on_close=on_close
        )
        self._statistics = RequestStatistics()
        self.plans = PlanRegistry(
            self._hands,
            workers=[PlanningWorker() for _ in range(self._limits.plans)],
            max_budget=self._limits.plan_budget,
            max_intervals=self._limits.intervals,
            publish=publish,
            count=self._statistics.count,
        )
        self._start = time.perf_counter()
        self._tasks: dict[str, Callable[[Any, _RequestOptions], dict[str, Any]]] = {
            "solve": self._solve,
            "status": self._status,
        }
        for name, hand in self._hands.items():
            self._tasks[protocol.hand_key(name)] = partial(self._describe, hand)
            self._tasks[f"{protocol.hand_key(name)}/distribute"] = partial(self._distribute, hand)
            self._tasks[f"{protocol.hand_key(name)}/control"] = partial(self._control, hand)

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that are served, below the prefix, beside those of streams."""
        return tuple(self._tasks)

    @property
    def plan_keys(self) -> tuple[str, ...]:
        """The keys of `plans`, below the prefix."""
        return tuple(f"{protocol.hand_key(name)}/plan" for name in self._hands)

    def answer(self, key: str, payload: bytes, encoding: str | None = None, received: float | None = None) -> Reply:
        """The reply to a request, whatever it holds.

        Args:
            key: what is asked, below the prefix.
            payload: the request.
            encoding: its Zenoh encoding; None for JSON.
            received: when it came, on the clock `time.perf_counter`; None for now.
        """
        received = time.perf_counter() if received is None else received
        codec, sequence = protocol.JSON, None
        try:
            codec = protocol.select_codec(encoding)
            task = self._find_task(key)
            if len(payload) > self._limits.payload:
                raise RequestRefused(
                    "too_large", f"the payload has {len(payload)} bytes: at most {self._limits.payload} are allowed"
                )
            request = protocol.decode(payload, codec) if payload or task == self._solve else {}
            sequence = protocol.find_sequence(request)
            envelope, record = protocol.Envelope.split(request)
            deadline = received + (math.inf if envelope.budget is None else envelope.budget)
            _check_deadline(deadline, "begun", received)
            with np.errstate(all="ignore"):  # what overflows cannot be certified, and is not handed out
                result = task(record, _RequestOptions(envelope.backend, deadline))
            _check_deadline(deadline, "done", received)
            result["server_seconds"] = time.perf_counter() - received
            if sequence is not None:
                result["sequence"] = sequence
            reply, outcome = Reply(True, protocol.encode(result, codec), codec), "ok"
        except Exception as error:
            outcome, message, field = describe_error(error, key)
            reply = make_error_reply(codec, outcome, message, field, sequence)
        self._statistics.count(self._statistics_key(key), outcome, time.perf_counter() - received)
        return reply

    def refuse(self, key: str, payload: bytes, encoding: str | None, code: str, message: str) -> Reply:
        """The reply to a request that nobody will work on, quickly made.

        Args:
            key: what was asked, below the prefix.
            payload: the request; a large one is not read, not even for its sequence number.
            encoding: its Zenoh encoding; None for JSON.
            code: a refusal's code, such as "overloaded".
            message: why.
        """
        codec, sequence = protocol.JSON, None
        try:
            codec = protocol.select_codec(encoding)
            sequence = protocol.find_sequence(protocol.decode(payload, codec)) if len(payload) <= _MAX_PARSED_BYTES else None
        except InvalidInput:
            pass  # the refusal stands, whatever the request says
        self._statistics.count(self._statistics_key(key), code)
        return make_error_reply(codec, code, message, None, sequence)

    def _find_task(self, key: str) -> Callable[[Any, _RequestOptions], dict[str, Any]]:
        if key in self._tasks:
            return self._tasks[key]
        top, _, rest = key.partition("/")
        if top == "streams" and "/" not in rest:
            return partial(self._stream, rest)
        hand = rest.removesuffix("/distribute").removesuffix("/control").removesuffix("/plan")
        if top == "hands" and hand not in self._hands:
            raise UnknownName(
                "hand", hand, self._hands, "" if self._hands else "the name of a served hand; this server has none"
            )
        raise UnknownName("key", key, (*self._tasks, *self.plan_keys))

    def _statistics_key(self, key: str) -> str:
        if key.startswith("streams/"):
            return "streams"
        return key if key in self._tasks else "other"  # strangers' keys must not fill the table

    def _solve(self, record: Any, options: _RequestOptions) -> dict[str, Any]:
        self._check_contact_count(record)
        return self._solve_problem(ForceProblem.from_dict(record), options)

    def _distribute(self, hand: Hand, record: Any, options: _RequestOptions) -> dict[str, Any]:
        self._check_contact_count(record)
        return self._solve_problem(make_force_problem(hand, DistributeRequest.from_dict(record)), options)

    def _control(self, hand: Hand, record: Any, options: _RequestOptions) -> dict[str, Any]:
        _reject_backend(options)
        self._check_contact_count(record.get("hold") if isinstance(record, dict) else None)
        return answer_control_request(ControlRequest.from_dict(hand, record))

    def _stream(self, id: str, record: Any, options: _RequestOptions) -> dict[str, Any]:
        _reject_backend(options)
        self._check_contact_count(record.get("hold") if isinstance(record, dict) else None)
        return self.streams.answer(id, record)

    def _describe(self, hand: Hand, record: Any, options: _RequestOptions) -> dict[str, Any]:
        _check_empty_request(record)
        return dict(hand.describe())

    def _status(self, record: Any, options: _RequestOptions) -> dict[str, Any]:
        _check_empty_request(record)
        return ServerStatus(
            version=graspforce.__version__,
            server=self._server,
            uptime=time.perf_counter() - self._start,
            hands=tuple(self._hands),
            queue=self._queue_length(),
            streams=len(self.streams),
            plans=len(self.plans),
            counts={**self._statistics.counts(), **_state_outcomes(self.streams)},
            latency=self._statistics.latency(),
        ).to_dict()

    def _solve_problem(self, problem: ForceProblem, options: _RequestOptions) -> dict[str, Any]:
        matrix_entries = _count_matrix_entries(problem)
        if matrix_entries > self._limits.matrix_entries:
            limit = f"at most {self._limits.matrix_entries} are allowed: use fewer contacts, joints or facets"
            raise RequestRefused("too_large", f"the problem's constraint matrix has {matrix_entries} entries: {limit}")
        left = options.deadline - _SEND_TIME - time.perf_counter() if matrix_entries <= _MAX_ENTRIES_TO_EXPLAIN else 0.0
        return solve(problem, options.backend, explain=min(max(left, 0.0), _MAX_EXPLANATION_TIME)).to_dict()

    def _check_contact_count(self, record: Any) -> None:
        """Refuse very many contacts before each of them is checked."""
        contacts = record.get("contacts") if isinstance(record, dict) else None
        if isinstance(contacts, list) and len(contacts) > self._limits.contacts:
            raise RequestRefused(
                "too_large", f"there are {len(contacts)} contacts: at most {self._limits.contacts} are allowed"
            )


def make_force_problem(hand: Hand, request: DistributeRequest) -> ForceProblem:
    """The force problem of a hand that holds an object.

    Args:
        hand: the hand.
        request: its posture, the object's pose, contacts and wrench.

    Raises:
        InvalidInput: a finger that the hand has not, or a vector of another length than its joints; named as in the request.
    """
    check_contact_fingers(hand, request.fingers, "contacts")
    rates = [(request.q, "posture"), (request.v, "velocity"), (request.a, "acceleration")]
    q, v, a = (None if x is None else arrays.check_array(x, field, (hand.n,)) for x, field in rates)
    contacts = ContactSet.stack(request.contacts)
    gravity = {} if request.gravity is None else {"gravity_H": request.gravity}
    actuation = hand.actuation(q, request.fingers, contacts, request.p_HO, request.R_HO, v=v, a=a, **gravity)
    return ForceProblem(contacts, request.w, actuation, request.cone, request.objective)


def _state_outcomes(streams: StreamRegistry) -> dict[str, dict[str, int]]:
    outcomes = streams.outcomes()
    return {"streams/*/state": outcomes} if outcomes else {}


def _check_deadline(deadline: float, what: str, received: float) -> None:
    now = time.perf_counter()
    if now > deadline:
        budget, taken = deadline - received, now - received
        raise RequestRefused(
            "deadline", f"the budget of {budget:.6g} s was over before the work was {what}, {taken:.6g} s after receipt"
        )


def _reject_backend(options: _RequestOptions) -> None:
    if options.backend is not None:
        raise InvalidInput("backend", options.backend, "absent: control keeps to the solver that is quickest for it")


def _check_empty_request(record: Any) -> None:
    fields.check_record(record, "", optional=["sequence", "budget"])


def _count_matrix_entries(problem: ForceProblem) -> int:
    """Entries of the dense matrix of all constraints: equilibrium, cones, normal forces, torques."""
    joints = 0 if problem.actuation is None else problem.actuation.J.shape[1]
    cone_rows = problem.size if problem.cone.type == "exact" else len(problem.contacts) * (problem.cone.facets + 1)
    return problem.size * (6 + cone_rows + 2 * len(problem.contacts) + 2 * joints)
