"""The client of the service: requests, control streams and plans over Zenoh."""

from __future__ import annotations

import dataclasses
import os
import uuid
import weakref
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from graspforce.control import ControlSettings
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.estimation.sensor_model import SensorModel
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import RankedGrasp
from graspforce.hand.hand import Hand
from graspforce.planning import IdealTask, Move, Plan, PlanFailure, ProgressCallback
from graspforce.planning.regrasp import RegraspPlan
from graspforce.service.client.command_stream import CommandStream, OpenSetup, StreamLink
from graspforce.service.client.joint_stream import JointStream
from graspforce.service.client.open_session import open_session
from graspforce.service.client.phase_stream import PhaseStream
from graspforce.service.client.replies import make_unreadable_error, parse_record
from graspforce.service.client.requests import Requests
from graspforce.service.client.server_presence import ServerPresence
from graspforce.service.client.server_version import check_server
from graspforce.service.client.stream import Stream
from graspforce.service.client.stream_monitor import StreamMonitor
from graspforce.service.client.watchdog import Watchdog
from graspforce.service.client.zenoh_connection import ZenohConnection
from graspforce.service.security.directory import CONTROLLER, client_settings
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import RemoteCommand, read_command
from graspforce.service.wire.control_records import DEFAULT_TORQUE_STEP, DEFAULT_VALIDITY, ControlRequest, StreamSetup
from graspforce.service.wire.distribute_records import DistributeRequest
from graspforce.service.wire.grasp_records import GraspRequest, read_grasp, read_grasps
from graspforce.service.wire.joint_records import JointStreamSetup
from graspforce.service.wire.kinematics_records import TipPose, read_posture, read_tip_poses
from graspforce.service.wire.phase_records import PhaseStreamSetup
from graspforce.service.wire.plan_records import read_answer
from graspforce.service.wire.regrasp_records import RegraspRequest, read_regrasp
from graspforce.service.wire.status_records import ServerStatus

_CODECS = {"msgpack": protocol.MSGPACK, "json": protocol.JSON}
_PLAN_BUDGET = 10.0  # s, default time for planning

S = TypeVar("S", bound=CommandStream[Any])


class Client:
    """Client of the service. Use it as a context manager, or call `close`. Thread-safe.

    A request without an answer raises:

    - `NoServer`: no server is alive; `ServerLost` if one was alive and ended, or was disconnected, before it answered;
    - `ServiceTimeout`: a server is alive, but its answer did not arrive in time;
    - `RequestRefused`: the request or the connection was refused: overloaded, deadline exceeded, too large, or not permitted;
    - `IncompatibleServer`: the server is of another version, and lacks what the request needs;
    - `ErrorReply`: the server returned an error record with code ``invalid``, ``unknown`` or ``internal``.

    If a server ends before it answers, the client sends the request to another one, once and within the timeout. The client
    reconnects to a restarted server within about a second.

    Args:
        connect: Zenoh endpoint of the server, or endpoints of several, of which the client uses the first that it reaches; by
            default ``tcp/127.0.0.1:7450`` (``tls/localhost:7450``), or the endpoint of the configuration file.
        config: path of a Zenoh configuration file, JSON or JSON5; its settings replace graspforce's, except `connect`.
        timeout: time to wait for each answer, s (default 1.0).
        encoding: ``"msgpack"`` (default) or ``"json"``.
        secure: directory with ``ca.pem`` and the certificate of the client, of `graspforce secure`; for servers with TLS.
        name: name of that certificate.

    Raises:
        NoServer: no server listens at the endpoint.
        ServiceTimeout: the endpoint does not answer in time.
        RequestRefused: a program listens at the endpoint, but refuses the connection; the code is ``forbidden``.
        InvalidInput: an argument is not allowed.
    """

    def __init__(
        self,
        connect: str | Sequence[str] | None = None,
        *,
        config: str | os.PathLike[str] | None = None,
        timeout: float = 1.0,
        encoding: Literal["msgpack", "json"] = "msgpack",
        secure: str | os.PathLike[str] | None = None,
        name: str = CONTROLLER,
    ) -> None:
        self._timeout = arrays.check_number(timeout, "timeout", above=0.0)
        self._codec = _CODECS[fields.check_choice(encoding, "encoding", list(_CODECS))]
        self._streams: weakref.WeakSet[CommandStream[Any]] = weakref.WeakSet()
        self._capabilities: frozenset[str] = frozenset()  # of the server, when it was asked
        self._name = None if secure is None else name
        tls = {} if secure is None else client_settings(secure, name)
        self._session, addresses = open_session(connect, config, self._timeout, tls)
        self._presence = ServerPresence(self._session, addresses, self._timeout)
        self._requests = Requests(self._session, self._presence, self._codec, self._timeout)

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the streams and the session. Python can exit without this call."""
        for stream in list(self._streams):
            stream.close()
        self._session.close()

    def solve(
        self,
        problem: ForceProblem | Mapping[str, object],
        *,
        backend: str | None = None,
        budget: float | None = None,
        timeout: float | None = None,
    ) -> Solution:
        """Solve a force problem, as `graspforce.solve`. Infeasibility is an answer, not an exception.

        Args:
            problem: a force problem, or its record.
            backend: name of the solver; by default the server's choice.
            budget: time in which the answer is useful, s, from receipt of the request; the server refuses later work. By
                default the timeout.
            timeout: time to wait for the answer, s; by default the client's.
        """
        record = problem.to_dict() if isinstance(problem, ForceProblem) else problem
        return parse_record(Solution.from_dict, self.query("solve", record, backend=backend, budget=budget, timeout=timeout))

    def distribute(
        self,
        hand: str,
        request: DistributeRequest | Mapping[str, object],
        *,
        backend: str | None = None,
        budget: float | None = None,
        timeout: float | None = None,
    ) -> Solution:
        """Compute the contact forces and motor torques of a hand that holds an object.

        Args:
            hand: name of the hand, one of `hands`.
            request: posture, object, contacts and wrench, or their record.
            backend: as in `solve`.
            budget: as in `solve`, s.
            timeout: as in `solve`, s.
        """
        record = request.to_dict() if isinstance(request, DistributeRequest) else request
        key = f"{protocol.hand_key(hand)}/distribute"
        return parse_record(Solution.from_dict, self.query(key, record, backend=backend, budget=budget, timeout=timeout))

    def control(self, request: ControlRequest, *, budget: float | None = None, timeout: float | None = None) -> RemoteCommand:
        """Compute one control step. The command has the certified solution of its force problem.

        Args:
            request: grasp, state and desired motion. Pass the `memory` of the last command to continue from it.
            budget: as in `solve`, s.
            timeout: as in `solve`, s.
        """
        key = f"{protocol.hand_key(request.grasp.hand.name)}/control"
        record = self.query(key, request.to_dict(), budget=budget, timeout=timeout)
        try:
            return read_command(request.grasp, record)
        except InvalidInput as error:
            raise make_unreadable_error(error) from None

    def open_stream(
        self,
        grasp: Grasp,
        settings: ControlSettings | None = None,
        *,
        validity: float = DEFAULT_VALIDITY,
        watchdog: Watchdog | None = None,
        sensors: SensorModel | None = None,
        torque_step: float = DEFAULT_TORQUE_STEP,
    ) -> Stream:
        """Open a control stream to an `ObjectController` at the server. Use it as a context manager, or call `close`.

        With `sensors`, the controller is an `OutputFeedbackController`, and `Stream.step` takes measurements.

        Args:
            grasp: hand, object and contacts; the server must serve the hand.
            settings: controller settings; by default `ControlSettings()`.
            validity: largest age of a good command, s, from when its state was sent (default 0.02).
            watchdog: motor torque while no commands arrive; by default `Watchdog()`.
            sensors: sensors of the hand; None for exact states.
            torque_step: largest change of a joint's torque from command to command, as a fraction of half its torque range.
        """
        options: JsonRecord = {"sensors": sensors, "torque_step": torque_step, "authenticated": True}
        setup = StreamSetup(grasp, settings or ControlSettings(), validity, **options)
        return self._open(Stream, setup, watchdog)

    def open_phase_stream(self, setup: PhaseStreamSetup, *, watchdog: Watchdog | None = None) -> PhaseStream:
        """Open a stream to a `PhaseController` at the server: the phases of a grasp from a table and back.

        Args:
            setup: plan, settings and sensors; the server must serve the hand.
            watchdog: motor torque while no commands arrive; by default `Watchdog()`.
        """
        return self._open(PhaseStream, dataclasses.replace(setup, authenticated=True), watchdog)

    def open_joint_stream(self, setup: JointStreamSetup, *, watchdog: Watchdog | None = None) -> JointStream:
        """Open a stream to a joint-space law at the server: a `JointController` or a `ForceController`.

        Args:
            setup: law, gains and period; the server must serve the hand.
            watchdog: motor torque while no commands arrive; by default `Watchdog()`.
        """
        return self._open(JointStream, dataclasses.replace(setup, authenticated=True), watchdog)

    def monitor_stream(self, id: str, *, sampled: bool = False) -> StreamMonitor:
        """Follow the states and commands of a running stream, which `status().active_streams` lists, without taking part.

        With TLS, the role is ``monitor``.

        Args:
            id: id of the stream.
            sampled: follow at most 60 states and commands a second, in place of all, so that the stream is not slowed.

        Raises:
            ErrorReply: no such stream is open.
            IncompatibleServer: the server has no setups of streams, or no samples.
        """
        self._require("stream_setups", *(["stream_samples"] if sampled else []))
        protocol.check_named_id(id, "stream")
        answer = self._requests.ask_stream(f"setups/{id}", {})
        return StreamMonitor(self._session, id, parse_record(dict, answer["setup"]), sampled=sampled)

    def _require(self, *capabilities: str) -> None:
        """Check once that the server can do what a request needs.

        Raises:
            IncompatibleServer: it cannot.
        """
        if not self._capabilities.issuperset(capabilities):
            status = self.status()
            self._capabilities = frozenset(status.capabilities)
            check_server(status, capabilities)

    def _open(self, kind: Callable[..., S], setup: OpenSetup, watchdog: Watchdog | None) -> S:
        """Return an open stream of a kind."""
        self._require("authenticated_streams", *(["measurements"] if getattr(setup, "sensors", None) is not None else []))
        id = self._named_id()
        link = StreamLink(
            watchdog=watchdog or Watchdog(),
            codec=self._codec,
            timeout=self._timeout,
            query=partial(self._requests.ask_stream, f"streams/{id}"),
            connect=partial(ZenohConnection, self._session, f"{protocol.PREFIX}/streams/{id}", self._codec),
        )
        stream = kind(id, setup, link)
        self._streams.add(stream)
        return stream

    def plan(
        self,
        move: Move,
        *,
        budget: float = _PLAN_BUDGET,
        callback: ProgressCallback | None = None,
        id: str | None = None,
    ) -> Plan | PlanFailure:
        """Plan the fastest move, as `move.plan`. A failure is an answer with its reason, not an exception.

        If this call ends early (an exception, Ctrl-C, or the end of the process), the server stops planning.

        Args:
            move: the move, for one of `hands`.
            budget: time for planning, s (default 10.0); after that the best plan so far is the answer.
            callback: called with the progress, in this thread. Return False to stop and get the best plan so far.
            id: id of the plan, by which any client can follow and cancel it; by default a random one.
        """
        id = self._named_id(id)
        if isinstance(move.task, IdealTask):
            raise InvalidInput("move.task", "IdealTask", "a task with a hand; the service knows hands by name")
        record = {**move.to_dict(), "id": id}
        key = f"{protocol.hand_key(move.task.hand.name)}/plan"
        answer = self._requests.ask_job(key, record, budget, partial(self.cancel, id), callback)
        return parse_record(partial(read_answer, move), answer)

    def plan_regrasp(
        self,
        request: RegraspRequest,
        *,
        budget: float = _PLAN_BUDGET,
        callback: ProgressCallback | None = None,
        id: str | None = None,
    ) -> RegraspPlan | PlanFailure:
        """Plan object moves and finger steps to a goal pose, as `graspforce.planning.regrasp.plan_regrasp_to`.

        A failure is an answer with its reason, not an exception. `RegraspController` executes the plan.

        Args:
            request: grasp, goal pose and settings, for one of `hands`.
            budget: time for the search, s (default 10.0).
            callback: called with the progress, in this thread: `iteration` counts finger steps that were tried, `fraction` is
                the farthest place on a path. Return False to stop.
            id: as in `plan`.
        """
        self._require("regrasp_search")
        id = self._named_id(id)
        key, record = f"{protocol.hand_key(request.goal.grasp.hand.name)}/regrasp", {**request.to_dict(), "id": id}
        answer = self._requests.ask_job(key, record, budget, partial(self.cancel, id), callback)
        return parse_record(partial(read_regrasp, request.goal), answer)

    def find_grasp(self, hand: Hand, request: GraspRequest, *, budget: float = _PLAN_BUDGET, id: str | None = None) -> Grasp:
        """Find a grasp of an object, as `graspforce.find_grasp`.

        Args:
            hand: the hand; the server must serve one of its name.
            request: the object, and what the grasp must bear.
            budget: time for the search, s (default 10.0); after that the best grasp so far is the answer.
            id: id by which any client can `cancel` the search; by default a random one.

        Raises:
            RequestRefused: no grasp was found within the budget; the message says what the best candidate lacks.
            ErrorReply: the object cannot be held, or an argument is not allowed.
        """
        return parse_record(partial(read_grasp, hand), self._query_grasps(hand, request, budget, id))

    def find_grasps(
        self, hand: Hand, request: GraspRequest, *, budget: float = _PLAN_BUDGET, id: str | None = None
    ) -> tuple[RankedGrasp, ...]:
        """Find `request.count` different grasps of an object, the best first, as `graspforce.grasp.find_grasps`.

        Args:
            hand: the hand; the server must serve one of its name.
            request: the object, what the grasps must bear, their number and the measure that orders them.
            budget: time for all searches, s (default 10.0); after that the grasps so far are the answer.
            id: id by which any client can `cancel` the search; by default a random one.

        Raises:
            RequestRefused: no grasp was found within the budget; the message says what the best candidate lacks.
            ErrorReply: the object cannot be held, or an argument is not allowed.
        """
        return parse_record(partial(read_grasps, hand), self._query_grasps(hand, request, budget, id))

    def _query_grasps(self, hand: Hand, request: GraspRequest, budget: float, id: str | None) -> JsonRecord:
        """Return the answer to a request for grasps."""
        id = self._named_id(id)
        key, record = f"{protocol.hand_key(hand.name)}/grasp", {**request.to_dict(), "id": id}
        return self._requests.ask_job(key, record, budget, partial(self.cancel, id))

    def cancel(self, id: str) -> None:
        """Stop a plan or a search; its answer is the best so far. Does nothing if there is no such plan.

        Without TLS, any client may stop any plan; with TLS, its own.

        Args:
            id: id of the plan.
        """
        self._session.put(f"{protocol.PREFIX}/plans/{self._named_id(id)}/cancel", b"")

    def _named_id(self, id: str | None = None) -> str:
        """Return an id, by default a random one, after the name of the client's certificate if it has one."""
        checked = uuid.uuid4().hex if id is None else protocol.check_named_id(id)
        return checked if self._name is None or "/" in checked else f"{self._name}/{checked}"

    def hand(self, name: str, posture: npt.ArrayLike | None = None) -> JsonRecord:
        """Return the description of a hand: fingers, joints, limits and the poses of its frames; see `Hand.describe`.

        Args:
            name: one of `hands`.
            posture: (n,) joint positions for the poses, rad; neutral by default.
        """
        request = {} if posture is None else {"posture": np.asarray(posture).tolist()}
        return parse_record(dict, self.query(protocol.hand_key(name), request))

    def forward(self, hand: str, posture: npt.ArrayLike) -> dict[str, TipPose]:
        """Return pose and Jacobian of each fingertip of a hand in a posture.

        Args:
            hand: name of the hand, one of `hands`.
            posture: (n,) joint positions, rad.
        """
        key = f"{protocol.hand_key(hand)}/forward"
        return parse_record(read_tip_poses, self.query(key, {"posture": np.asarray(posture).tolist()}))

    def inverse(self, hand: str, tips: Mapping[str, npt.ArrayLike], start: npt.ArrayLike | None = None) -> Array:
        """Return the posture (n,), rad, in which fingertips are at given points; see `Hand.tip_posture`.

        Args:
            hand: name of the hand, one of `hands`.
            tips: for each finger the (3,) target of its tip frame's origin in H, m.
            start: (n,) posture to start from, rad; neutral by default.
        """
        record: JsonRecord = {"tips": {finger: np.asarray(p).tolist() for finger, p in tips.items()}}
        if start is not None:
            record["start"] = np.asarray(start).tolist()
        return parse_record(read_posture, self.query(f"{protocol.hand_key(hand)}/inverse", record))

    def hands(self) -> tuple[str, ...]:
        """Return the names of the hands that the server serves."""
        return self.status().hands

    def status(self) -> ServerStatus:
        """Return the server's status: version, queue, streams, plans, counts and latencies."""
        return parse_record(ServerStatus.from_dict, self.query("status", {}))

    def servers(self) -> tuple[str, ...]:
        """Return the ids of the servers that are alive; empty if there are none."""
        return self._presence.servers()

    def query(
        self,
        key: str,
        record: Mapping[str, object],
        *,
        backend: str | None = None,
        budget: float | None = None,
        timeout: float | None = None,
    ) -> JsonRecord:
        """Send a request to any key and return the whole answer, with `server_seconds` and `sequence`.

        Args:
            key: key after ``graspforce/1/``, such as ``"solve"`` or ``"status"``.
            record: the request without its envelope.
            backend: as in `solve`.
            budget: as in `solve`, s.
            timeout: as in `solve`, s.
        """
        return self._requests.ask(key, record, backend, budget, timeout)
