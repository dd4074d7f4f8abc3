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
from graspforce import arrays, fields
from graspforce.contact import ContactSet
from graspforce.errors import InvalidInput, Refused, UnknownName
from graspforce.hand import Hand
from graspforce.problem import ForceProblem
from graspforce.service import wire
from graspforce.service.control_records import ControlRequest
from graspforce.service.holds import known_fingers
from graspforce.service.meter import Meter
from graspforce.service.planner import Planner
from graspforce.service.plans import Plans
from graspforce.service.records import DistributeRequest, ServerStatus
from graspforce.service.reply import Reply, error_reply, what_went_wrong
from graspforce.service.streams import ControlStream, Streams, control
from graspforce.solve import solve

log = logging.getLogger("graspforce.service")

# What would make an infeasible problem feasible takes some forty solves. It is not worked out when the proof has not this much
# time, s, to be sent, nor for longer than this, s, while others wait, nor for problems with more entries in their constraint
# matrix than this.
_TIME_TO_SEND = 0.1
_LONGEST_EXPLANATION = 1.0
_MOST_TO_EXPLAIN = 100_000
_SMALL = 64 * 2**10  # bytes of a request that is read for its sequence number alone


@dataclass(frozen=True, slots=True)
class Limits:
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
    numbers: int = 5_000_000
    streams: int = 64
    plans: int = 2
    planning: float = 60.0
    intervals: int = 500
    idle: float = 10.0


@dataclass(frozen=True, slots=True)
class _Terms:
    """On what terms a request is worked on: with which solver, and until when on the clock `time.perf_counter`, s."""

    backend: str | None
    deadline: float


class Handler:
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
        queued: Callable[[], int] = lambda: 0,
        limits: Limits | None = None,
        opened: Callable[[ControlStream], None] = lambda stream: None,
        closed: Callable[[ControlStream], None] = lambda stream: None,
        publish: Callable[[str, Reply], None] = lambda id, reply: None,
    ) -> None:
        self._hands: dict[str, Hand] = {}
        for hand in hands:
            if hand.name in self._hands:
                raise InvalidInput("hands", hand.name, "of different names")
            self._hands[hand.name] = hand
        self._server, self._queued, self._limits = server, queued, limits or Limits()
        room, idle = self._limits.streams, self._limits.idle
        self.streams = Streams(self._hands, room=room, idle=idle, opened=opened, closed=closed)
        self._meter = Meter()
        self.plans = Plans(
            self._hands,
            planners=[Planner() for _ in range(self._limits.plans)],
            longest=self._limits.planning,
            finest=self._limits.intervals,
            publish=publish,
            count=self._meter.count,
        )
        self._start = time.perf_counter()
        self._tasks: dict[str, Callable[[Any, _Terms], dict[str, Any]]] = {"solve": self._solve, "status": self._status}
        for name, hand in self._hands.items():
            self._tasks[wire.hand_key(name)] = partial(self._describe, hand)
            self._tasks[f"{wire.hand_key(name)}/distribute"] = partial(self._distribute, hand)
            self._tasks[f"{wire.hand_key(name)}/control"] = partial(self._control, hand)

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that are served, below the prefix, beside those of streams."""
        return tuple(self._tasks)

    @property
    def plan_keys(self) -> tuple[str, ...]:
        """The keys of `plans`, below the prefix."""
        return tuple(f"{wire.hand_key(name)}/plan" for name in self._hands)

    def answer(self, key: str, payload: bytes, encoding: str | None = None, received: float | None = None) -> Reply:
        """The reply to a request, whatever it holds.

        Args:
            key: what is asked, below the prefix.
            payload: the request.
            encoding: its Zenoh encoding; None for JSON.
            received: when it came, on the clock `time.perf_counter`; None for now.
        """
        received = time.perf_counter() if received is None else received
        codec, sequence = wire.JSON, None
        try:
            codec = wire.codec(encoding)
            task = self._task(key)
            if len(payload) > self._limits.payload:
                raise Refused("too_large", f"the payload has {len(payload)} bytes: at most {self._limits.payload} are allowed")
            request = wire.decode(payload, codec) if payload or task == self._solve else {}
            sequence = wire.sequence_in(request)
            envelope, record = wire.Envelope.split(request)
            deadline = received + (math.inf if envelope.budget is None else envelope.budget)
            _in_time(deadline, "begun", received)
            with np.errstate(all="ignore"):  # what overflows cannot be certified, and is not handed out
                result = task(record, _Terms(envelope.backend, deadline))
            _in_time(deadline, "done", received)
            result["server_seconds"] = time.perf_counter() - received
            if sequence is not None:
                result["sequence"] = sequence
            reply, outcome = Reply(True, wire.encode(result, codec), codec), "ok"
        except Exception as error:
            outcome, message, field = what_went_wrong(error, key)
            reply = error_reply(codec, outcome, message, field, sequence)
        self._meter.count(self._counted(key), outcome, time.perf_counter() - received)
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
        codec, sequence = wire.JSON, None
        try:
            codec = wire.codec(encoding)
            sequence = wire.sequence_in(wire.decode(payload, codec)) if len(payload) <= _SMALL else None
        except InvalidInput:
            pass  # the refusal stands, whatever the request says
        self._meter.count(self._counted(key), code)
        return error_reply(codec, code, message, None, sequence)

    def _task(self, key: str) -> Callable[[Any, _Terms], dict[str, Any]]:
        if key in self._tasks:
            return self._tasks[key]
        room, _, rest = key.partition("/")
        if room == "streams" and "/" not in rest:
            return partial(self._stream, rest)
        hand = rest.removesuffix("/distribute").removesuffix("/control").removesuffix("/plan")
        if room == "hands" and hand not in self._hands:
            raise UnknownName("hand", hand, "one of " + ", ".join(self._hands) if self._hands else "absent: no hand is served")
        raise UnknownName("key", key, "one of " + ", ".join((*self._tasks, *self.plan_keys)))

    def _counted(self, key: str) -> str:
        if key.startswith("streams/"):
            return "streams"
        return key if key in self._tasks else "other"  # strangers' keys must not fill the table

    def _solve(self, record: Any, terms: _Terms) -> dict[str, Any]:
        self._few_contacts(record)
        return self._answer_to(ForceProblem.from_dict(record), terms)

    def _distribute(self, hand: Hand, record: Any, terms: _Terms) -> dict[str, Any]:
        self._few_contacts(record)
        return self._answer_to(force_problem(hand, DistributeRequest.from_dict(record)), terms)

    def _control(self, hand: Hand, record: Any, terms: _Terms) -> dict[str, Any]:
        _own_solver(terms)
        self._few_contacts(record.get("hold") if isinstance(record, dict) else None)
        return control(ControlRequest.from_dict(hand, record))

    def _stream(self, id: str, record: Any, terms: _Terms) -> dict[str, Any]:
        _own_solver(terms)
        self._few_contacts(record.get("hold") if isinstance(record, dict) else None)
        return self.streams.answer(id, record)

    def _describe(self, hand: Hand, record: Any, terms: _Terms) -> dict[str, Any]:
        _nothing_asked(record)
        return dict(hand.describe())

    def _status(self, record: Any, terms: _Terms) -> dict[str, Any]:
        _nothing_asked(record)
        return ServerStatus(
            version=graspforce.__version__,
            server=self._server,
            uptime=time.perf_counter() - self._start,
            hands=tuple(self._hands),
            queue=self._queued(),
            streams=len(self.streams),
            plans=len(self.plans),
            counts={**self._meter.counts(), **_states(self.streams)},
            latency=self._meter.latency(),
        ).to_dict()

    def _answer_to(self, problem: ForceProblem, terms: _Terms) -> dict[str, Any]:
        numbers = _matrix_numbers(problem)
        if numbers > self._limits.numbers:
            limit = f"at most {self._limits.numbers} are allowed: use fewer contacts, joints or facets"
            raise Refused("too_large", f"the problem's constraint matrix has {numbers} entries: {limit}")
        left = terms.deadline - _TIME_TO_SEND - time.perf_counter() if numbers <= _MOST_TO_EXPLAIN else 0.0
        return solve(problem, terms.backend, explain=min(max(left, 0.0), _LONGEST_EXPLANATION)).to_dict()

    def _few_contacts(self, record: Any) -> None:
        """Refuse very many contacts before each of them is checked."""
        contacts = record.get("contacts") if isinstance(record, dict) else None
        if isinstance(contacts, list) and len(contacts) > self._limits.contacts:
            raise Refused("too_large", f"there are {len(contacts)} contacts: at most {self._limits.contacts} are allowed")


def force_problem(hand: Hand, request: DistributeRequest) -> ForceProblem:
    """The force problem of a hand that holds an object.

    Args:
        hand: the hand.
        request: its posture, the object's pose, contacts and wrench.

    Raises:
        InvalidInput: a finger that the hand has not, or a vector of another length than its joints; named as in the request.
    """
    known_fingers(hand, request.fingers, "contacts")
    rates = [(request.q, "posture"), (request.v, "velocity"), (request.a, "acceleration")]
    q, v, a = (None if x is None else arrays.array(x, field, (hand.n,)) for x, field in rates)
    contacts = ContactSet.stack(request.contacts)
    gravity = {} if request.gravity is None else {"gravity_H": request.gravity}
    actuation = hand.actuation(q, request.fingers, contacts, request.p_HO, request.R_HO, v=v, a=a, **gravity)
    return ForceProblem(contacts, request.w, actuation, request.cone, request.objective)


def _states(streams: Streams) -> dict[str, dict[str, int]]:
    outcomes = streams.outcomes()
    return {"streams/*/state": outcomes} if outcomes else {}


def _in_time(deadline: float, what: str, received: float) -> None:
    now = time.perf_counter()
    if now > deadline:
        budget, taken = deadline - received, now - received
        raise Refused(
            "deadline", f"the budget of {budget:.6g} s was over before the work was {what}, {taken:.6g} s after receipt"
        )


def _own_solver(terms: _Terms) -> None:
    if terms.backend is not None:
        raise InvalidInput("backend", terms.backend, "absent: control keeps to the solver that is quickest for it")


def _nothing_asked(record: Any) -> None:
    fields.record(record, "", optional=["sequence", "budget"])


def _matrix_numbers(problem: ForceProblem) -> int:
    """Entries of the dense matrix of all constraints: equilibrium, cones, normal forces, torques."""
    joints = 0 if problem.hand is None else problem.hand.J.shape[1]
    cone_rows = problem.size if problem.cone.type == "exact" else len(problem.contacts) * (problem.cone.facets + 1)
    return problem.size * (6 + cone_rows + 2 * len(problem.contacts) + 2 * joints)
