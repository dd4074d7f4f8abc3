"""Answers to requests: encoded records in, encoded records out. It does not use the network.

Every request gets exactly one reply. Exceptions become error records; an unexpected one is logged and answered as ``internal``.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np

import graspforce
from graspforce.analysis.explain import explain
from graspforce.analysis.quality import quality
from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput, RequestRefused, UnknownName
from graspforce.core.json_text import JsonRecord
from graspforce.core.printable import escape_controls
from graspforce.force.problem import ForceProblem
from graspforce.force.solver import solve
from graspforce.geometry.shape import Solid
from graspforce.hand.hand import Hand
from graspforce.service.server.force_requests import check_matrix_entries, make_force_problem
from graspforce.service.server.limits import ServerLimits
from graspforce.service.server.plan_registry import PlanRegistry
from graspforce.service.server.request_checks import check_contact_count, check_deadline, check_empty_request, reject_backend
from graspforce.service.server.request_statistics import RequestStatistics
from graspforce.service.server.server_load import ServerLoad, client_label, resident_bytes
from graspforce.service.server.server_stream import ServerStream, answer_control_request
from graspforce.service.server.stream_registry import StreamRegistry
from graspforce.service.wire import protocol
from graspforce.service.wire.control_records import ControlRequest
from graspforce.service.wire.distribute_records import DistributeRequest
from graspforce.service.wire.kinematics_records import forward_record, inverse_record
from graspforce.service.wire.reply import Reply, make_error_reply, make_failure_reply
from graspforce.service.wire.schemas.catalogue import SCHEMA, wire_schema
from graspforce.service.wire.status_records import ServerStatus
from graspforce.service.workers.jobs import TASKS
from graspforce.service.workers.planning_worker import PlanningWorker

# The changes that would make an infeasible problem feasible take about forty solves. They are omitted if the time is short or
# the problem is large; the proof of infeasibility is always in the answer.
_SEND_TIME = 0.1  # s of the budget that are kept for the answer's way back
_MAX_EXPLANATION_TIME = 1.0  # s, because other requests wait
_MAX_ENTRIES_TO_EXPLAIN = 100_000  # of the constraint matrix
SETUPS = "setups"  # first part of the keys of the setups of open streams
HAND_TASKS = ("control", "distribute", "forward", "inverse", *TASKS)  # last parts of the keys below hands/<hand>
_MESSAGES = ("/state", "/command")  # ends of the keys of a stream's messages
_CAPABILITIES = (
    "grasp_search", "measurements", "contact_changes", "authenticated_streams", "torque_step", "client_keys", "regrasp_search",
    "stream_setups",
    "stream_samples",
)  # fmt: skip
log = logging.getLogger("graspforce.service")

MAX_PARSED_BYTES = 64 * 2**10  # of a refused request, which is parsed only for its sequence number


@dataclass(frozen=True, slots=True)
class _RequestOptions:
    """Options of a request: the solver's name or None, the deadline on the clock `time.perf_counter`, s, and the client."""

    backend: str | None
    deadline: float
    client: bytes


_Task: TypeAlias = Callable[[object, _RequestOptions], JsonRecord]


class RequestHandler:
    """Answers to requests by key. Thread-safe.

    Args:
        hands: the hands to serve.
        server: id of the server, for its status.
        load: function that returns the load of the server, for the status.
        limits: limits on requests, streams and plans; by default `ServerLimits()`.
        on_open: called with each new control stream.
        on_close: called with each closed control stream.
        publish: called with the id of a plan and its progress.

    Attributes:
        streams: the open control streams.
        plans: the active plans; it answers the keys in `plan_keys`, without waiting.

    Raises:
        InvalidInput: two hands have the same name, or a name cannot be part of a key.
    """

    def __init__(
        self,
        hands: Sequence[Hand] = (),
        *,
        server: str = "",
        load: Callable[[], ServerLoad] = ServerLoad,
        limits: ServerLimits | None = None,
        on_open: Callable[[ServerStream], None] = lambda stream: None,
        on_close: Callable[[ServerStream], None] = lambda stream: None,
        publish: Callable[[str, Reply], None] = lambda id, reply: None,
    ) -> None:
        self._hands: dict[str, Hand] = {}
        for hand in hands:
            if hand.name in self._hands:
                raise InvalidInput("hands", hand.name, "a list of hands with different names")
            self._hands[hand.name] = hand
        self._server, self._limits, self._load = server, limits or ServerLimits(), load
        self.streams = StreamRegistry(
            self._hands,
            capacity=self._limits.streams,
            client_capacity=self._limits.client_streams,
            idle_timeout=self._limits.idle_timeout,
            on_open=on_open,
            on_close=on_close,
        )
        self._statistics = RequestStatistics()
        self.plans = PlanRegistry(
            self._hands,
            workers=[PlanningWorker(memory=self._limits.plan_memory) for _ in range(self._limits.plans)],
            limits=self._limits,
            publish=publish,
            count=self._statistics.count,
        )
        self._start = time.perf_counter()
        self._tasks: dict[str, _Task] = {
            "solve": self._solve,
            "quality": self._quality,
            "explain": self._explain,
            "status": self._status,
        }
        for hand in self._hands.values():
            self._tasks |= self._hand_tasks(hand)

    def _hand_tasks(self, hand: Hand) -> dict[str, _Task]:
        """Return the functions that answer the keys of a hand."""
        key = protocol.hand_key(hand.name)
        return {
            key: partial(self._describe, hand),
            f"{key}/distribute": partial(self._distribute, hand),
            f"{key}/control": partial(self._control, hand),
            f"{key}/forward": partial(self._forward, hand),
            f"{key}/inverse": partial(self._inverse, hand),
        }

    def replace_hand(self, hand: Hand) -> None:
        """Serve a changed hand in place of the one with its name; open streams keep theirs.

        Args:
            hand: the hand.

        Raises:
            UnknownName: no hand of this name is served.
        """
        if hand.name not in self._hands:
            raise UnknownName("hand", hand.name, self._hands)
        self._hands[hand.name] = hand
        self._tasks |= self._hand_tasks(hand)
        self.plans.forget_hand(hand.name)

    @property
    def keys(self) -> tuple[str, ...]:
        """Served keys after the prefix, without those of streams and plans."""
        return tuple(self._tasks)

    @property
    def plan_keys(self) -> tuple[str, ...]:
        """Keys after the prefix that planning processes serve: moves, regrasps and grasps."""
        return tuple(f"{protocol.hand_key(name)}/{task}" for name in self._hands for task in TASKS)

    def answer(
        self, key: str, payload: bytes, encoding: str | None = None, received: float | None = None, client: bytes = b""
    ) -> Reply:
        """Return the reply to a request.

        Args:
            key: key after the prefix, or the whole key if its prefix has another version.
            payload: the encoded request.
            encoding: its Zenoh encoding; None for JSON.
            received: when it arrived, on the clock `time.perf_counter`, s; None for now.
            client: session of the client.
        """
        received = time.perf_counter() if received is None else received
        outcome, reply = self.compute(key, payload, encoding, received, client)
        self.count(key, outcome, time.perf_counter() - received)
        return reply

    def compute(
        self, key: str, payload: bytes, encoding: str | None, received: float, client: bytes = b""
    ) -> tuple[str, Reply]:
        """Return the outcome and the reply of a request, without counting it: "ok" or an error code.

        Args:
            key: as in `answer`.
            payload: as in `answer`.
            encoding: as in `answer`.
            received: as in `answer`, s.
            client: as in `answer`.
        """
        codec, sequence = protocol.JSON, None
        try:
            codec = protocol.select_codec(encoding)
            task = self._find_task(key)
            if len(payload) > self._limits.payload:
                message = f"the payload has {len(payload)} bytes: at most {self._limits.payload} are allowed"
                raise RequestRefused("too_large", message)
            request = protocol.decode(payload, codec) if payload or task == self._solve else {}
            sequence = protocol.find_sequence(request)
            envelope, record = protocol.Envelope.split(request)
            deadline = received + (self._limits.budget if envelope.budget is None else envelope.budget)
            check_deadline(deadline, "begun", received)
            with np.errstate(all="ignore"):  # results that overflow fail certification
                result = task(record, _RequestOptions(envelope.backend, deadline, client))
            check_deadline(deadline, "finished", received)
            result["server_seconds"] = time.perf_counter() - received
            if sequence is not None:
                result["sequence"] = sequence
            outcome, reply = "ok", Reply(True, protocol.encode(result, codec), codec)
        except Exception as error:
            outcome, reply = make_failure_reply(codec, error, key, sequence, client_label(client))
        if log.isEnabledFor(logging.DEBUG):
            about = {"client": client_label(client), "sequence": sequence}
            log.debug("%s: %s in %.6f s", escape_controls(key), outcome, time.perf_counter() - received, extra=about)
        return outcome, reply

    def count(self, key: str, outcome: str, seconds: float) -> None:
        """Count a request in the statistics.

        Args:
            key: key after the prefix.
            outcome: "ok" or an error code.
            seconds: time from receipt to answer, s.
        """
        self._statistics.count(self._statistics_key(key), outcome, seconds)

    def refuse(
        self,
        key: str,
        payload: bytes,
        encoding: str | None,
        code: str,
        message: str,
        retry_after: float | None = None,
    ) -> Reply:
        """Return the reply to a request that is refused without work.

        Args:
            key: key after the prefix.
            payload: the encoded request; a large one is not parsed, so that its sequence number is not repeated.
            encoding: its Zenoh encoding; None for JSON.
            code: error code, such as "overloaded".
            message: text for the user.
            retry_after: time after which the request may be repeated, s.
        """
        codec, sequence = protocol.JSON, None
        try:
            codec = protocol.select_codec(encoding)
            sequence = protocol.read_sequence(payload, codec) if len(payload) <= MAX_PARSED_BYTES else None
        except InvalidInput:
            pass  # the refusal has priority over errors in the request
        self._statistics.count(self._statistics_key(key), code)
        return make_error_reply(codec, code, message, None, sequence, retry_after)

    def _find_task(self, key: str) -> _Task:
        """Return the function that answers a key."""
        if key in self._tasks:
            return self._tasks[key]
        top, _, rest = key.partition("/")
        if top == protocol.NAMESPACE:
            raise UnknownName("version", rest.partition("/")[0], [protocol.VERSION])
        if top == SCHEMA:
            return partial(self._schema, rest)
        if top == SETUPS and rest.count("/") <= 1:
            return partial(self._setup, rest)
        if top == "streams" and rest.count("/") <= 1 and not rest.endswith(_MESSAGES):
            return partial(self._stream, rest)
        hand, _, task = rest.rpartition("/")
        hand = hand if task in HAND_TASKS else rest
        if top == "hands" and hand not in self._hands:
            allowed = "" if self._hands else "the name of a served hand; this server has none"
            raise UnknownName("hand", hand, self._hands, allowed)
        raise UnknownName(
            "key",
            key,
            (*self._tasks, *self.plan_keys, "streams/<id>", "streams/<client>/<id>", f"{SETUPS}/<id>", f"{SCHEMA}/<name>"),
        )

    def _statistics_key(self, key: str) -> str:
        """Return the key under which a request is counted; unknown keys have one, so that clients cannot grow the table."""
        if key.startswith("streams/"):
            return "streams"
        for top in (SCHEMA, SETUPS):
            if key.startswith(f"{top}/"):
                return top
        return key if key in self._tasks else "other"

    def _solve(self, record: Any, options: _RequestOptions) -> JsonRecord:
        """Answer ``solve``."""
        check_contact_count(record, self._limits.contacts)
        return self._solve_problem(ForceProblem.from_dict(record), options)

    def _quality(self, record: Any, options: _RequestOptions) -> JsonRecord:
        """Answer ``quality``."""
        reject_backend(options.backend)
        shape = None
        if isinstance(record, dict) and record.get("shape") is not None:
            record = dict(record)
            shape = Solid.from_dict(record.pop("shape"))
        problem, direction = self._problem_and_direction(record)
        return quality(problem, direction, seconds=self._answer_seconds(options), shape=shape).to_dict()

    def _explain(self, record: Any, options: _RequestOptions) -> JsonRecord:
        """Answer ``explain``."""
        reject_backend(options.backend)
        problem, direction = self._problem_and_direction(record)
        seconds = min(self._seconds_left(options), _MAX_EXPLANATION_TIME)
        return explain(problem, direction, seconds=seconds).to_dict()

    def _problem_and_direction(self, record: Any) -> tuple[ForceProblem, Any]:
        """Return the force problem of a request, and its optional direction."""
        check_contact_count(record, self._limits.contacts)
        direction = None
        if isinstance(record, dict):
            record = dict(record)
            direction = record.pop("direction", None)
        problem = ForceProblem.from_dict(record)
        check_matrix_entries(problem, self._limits.matrix_entries)
        return problem, direction

    def _distribute(self, hand: Hand, record: object, options: _RequestOptions) -> JsonRecord:
        """Answer ``hands/<hand>/distribute``."""
        check_contact_count(record, self._limits.contacts)
        solution = self._solve_problem(make_force_problem(hand, DistributeRequest.from_dict(record)), options)
        return {**solution, "joints": list(hand.joint_names)}

    def _control(self, hand: Hand, record: object, options: _RequestOptions) -> JsonRecord:
        """Answer ``hands/<hand>/control``."""
        reject_backend(options.backend)
        check_contact_count(record.get("hold") if isinstance(record, dict) else None, self._limits.contacts)
        return answer_control_request(ControlRequest.from_dict(hand, record))

    def _stream(self, id: str, record: object, options: _RequestOptions) -> JsonRecord:
        """Answer ``streams/<id>`` and ``streams/<client>/<id>``."""
        reject_backend(options.backend)
        given = record if isinstance(record, dict) else {}
        plan = given.get("plan")
        check_contact_count(plan.get("hold") if isinstance(plan, dict) else given.get("hold"), self._limits.contacts)
        return self.streams.answer(id, record, options.client)

    def _setup(self, id: str, record: object, options: _RequestOptions) -> JsonRecord:
        """Answer ``setups/<id>`` and ``setups/<client>/<id>``."""
        check_empty_request(record)
        return self.streams.setup(id)

    def _describe(self, hand: Hand, record: object, options: _RequestOptions) -> JsonRecord:
        """Answer ``hands/<hand>``."""
        posture = fields.check_record(record, "", optional=["sequence", "budget", "posture"]).get("posture")
        return hand.describe(None if posture is None else arrays.check_array(posture, "posture", (hand.n,)))

    def _schema(self, name: str, record: object, options: _RequestOptions) -> JsonRecord:
        """Answer ``schema/<name>``."""
        return dict(wire_schema(name))

    def _forward(self, hand: Hand, record: object, options: _RequestOptions) -> JsonRecord:
        """Answer ``hands/<hand>/forward``."""
        reject_backend(options.backend)
        return forward_record(hand, record)

    def _inverse(self, hand: Hand, record: object, options: _RequestOptions) -> JsonRecord:
        """Answer ``hands/<hand>/inverse``."""
        reject_backend(options.backend)
        return inverse_record(hand, record)

    def _status(self, record: object, options: _RequestOptions) -> JsonRecord:
        """Answer ``status``."""
        check_empty_request(record)
        return self.status().to_dict()

    def status(self) -> ServerStatus:
        """Return the status of the server."""
        states, load = self.streams.outcomes(), self._load()
        own = {"waiting": load.clients, "streams": self.streams.count_by_client(), "plans": self.plans.count_by_client()}
        sessions = sorted({session for counts in own.values() for session in counts})
        return ServerStatus(
            version=graspforce.__version__,
            server=self._server,
            uptime=time.perf_counter() - self._start,
            hands=tuple(self._hands),
            queue=load.waiting,
            streams=len(self.streams),
            plans=len(self.plans),
            counts={**self._statistics.counts(), **({"streams/*/state": states} if states else {})},
            latency=self._statistics.latency(),
            capabilities=_CAPABILITIES,
            queue_bytes=load.queue_bytes,
            problem=load.problem,
            memory=resident_bytes(),
            latencies=self._statistics.histograms(),
            active_streams=self.streams.statuses(),
            addresses=load.addresses,
            clients={client_label(each): {name: counts.get(each, 0) for name, counts in own.items()} for each in sessions},
        )

    def _solve_problem(self, problem: ForceProblem, options: _RequestOptions) -> JsonRecord:
        """Return the record of a force problem's solution."""
        is_small = check_matrix_entries(problem, self._limits.matrix_entries) <= _MAX_ENTRIES_TO_EXPLAIN
        explain_seconds = self._answer_seconds(options) if is_small else 0.0
        return solve(problem, options.backend, explain_seconds=explain_seconds, deadline=self._seconds_left(options)).to_dict()

    def _answer_seconds(self, options: _RequestOptions) -> float:
        """Return the time for numbers beyond the solution, s."""
        remaining = options.deadline - _SEND_TIME - time.perf_counter()  # s
        return min(max(remaining, 0.0), _MAX_EXPLANATION_TIME)

    def _seconds_left(self, options: _RequestOptions) -> float:
        """Return the time for the work on a request, s: the rest of its budget without the time to send the answer."""
        remaining = max(options.deadline - time.perf_counter(), 0.0)  # s
        return max(remaining - _SEND_TIME, 0.5 * remaining)
