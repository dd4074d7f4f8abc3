"""Control of one grasp from messages: hold, move along a plan, and release. It does not use the network. Frame: H hand base."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, DesiredMotion, ObjectControlLaw
from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.joints.joint_controller import JointController
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, RequestRefused
from graspforce.core.records import set_fields
from graspforce.estimation.measurement import Measurement, PoseMeasurement
from graspforce.estimation.sensor_model import CameraModel, SensorModel
from graspforce.geometry.minimum_jerk import minimum_jerk
from graspforce.grasp.grasp import Grasp
from graspforce.hand.descriptions.drive_description import DriveMode
from graspforce.hand.hand import Hand
from graspforce.planning.tracking import TimeScaledPlan
from graspforce.service.client.stream_changes import resumed_setup
from graspforce.service.ros2.fingertip_wrenches import FingertipWrenches
from graspforce.service.ros2.messages import JointSample, PoseSample
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import CommandRecord, RemoteCommand
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.joint_records import JointCommandRecord, JointState, JointStreamSetup
from graspforce.service.wire.stream_state import StreamState

Interface = Literal["effort", "position"]
Mode = Literal["idle", "holding", "released"]

_POSITION_MODES: tuple[DriveMode, ...] = ("position", "position_with_current_limit")  # drives that take a position alone
_LARGEST_POSTURE_ERROR = 0.1  # rad: a grasp whose joints are farther away is another one
_RELEASE_FREQUENCY = 3.0  # Hz, of the joint-space law that opens the hand
_SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)  # of the opening, tried in turn until a finger can reach it
_MIN_RATE, _MAX_RATE = 50.0, 2000.0  # Hz
_COMMANDS = msgspec.msgpack.Decoder(CommandRecord)
_JOINT_COMMANDS = msgspec.msgpack.Decoder(JointCommandRecord)


@dataclass(frozen=True, slots=True)
class HoldOptions:
    """How a grasp is controlled.

    Args:
        rate: joint states per second, Hz, 50 to 2000.
        interface: what the commands are: joint torques, N·m, or positions, rad, for drives that take positions. None for
            positions if all drives take them.
        encoder_noise: standard deviation of a measured joint position, rad.
        tip_force_noise: standard deviation of each component of a measured fingertip force, N; None if they are not measured.
        camera: noise and latency of the measured poses of the object; None if nothing measures them.
        settings: settings of the controller; gains, period and position error follow from the sensors.
        opening: distance by which a release moves the fingertips from the object, m; less where a finger cannot reach it.
        release_time: time of the release, s.

    Raises:
        InvalidInput: a value is out of range.
    """

    rate: float = 500.0
    interface: Interface | None = None
    encoder_noise: float = 1e-4
    tip_force_noise: float | None = None
    camera: CameraModel | None = field(default_factory=CameraModel)
    settings: ControlSettings = field(default_factory=ControlSettings)
    opening: float = 0.015
    release_time: float = 1.0

    def __post_init__(self) -> None:
        rate = arrays.check_number(self.rate, "rate", minimum=_MIN_RATE)
        if rate > _MAX_RATE:
            raise InvalidInput("rate", rate, f"at most {_MAX_RATE:g} Hz")
        if self.interface is not None:
            fields.check_choice(self.interface, "interface", ("effort", "position"))
        above = {name: arrays.check_number(getattr(self, name), name, above=0.0) for name in ("opening", "release_time")}
        noise = arrays.check_number(self.encoder_noise, "encoder_noise", minimum=0.0)
        if self.tip_force_noise is not None:
            arrays.check_number(self.tip_force_noise, "tip_force_noise", above=0.0)
        set_fields(self, rate=rate, encoder_noise=noise, **above)

    @property
    def sensors(self) -> SensorModel:
        """The sensors of the hand."""
        tips = self.tip_force_noise
        return SensorModel(encoder_noise=self.encoder_noise, rate=self.rate, tip_force_noise=tips, camera=self.camera)


class HoldCommand(NamedTuple):
    """A command to the drives.

    Attributes:
        values: (n,) joint torques, N·m, or positions, rad.
        record: record of the command of a grasp; None while the hand opens.
    """

    values: Array
    record: CommandRecord | None


class HoldControl:
    """Control of one grasp. Any thread may call it.

    It begins ``idle``: joint states are read, and no commands returned. `open` begins to hold, and `release` opens the hand.

    Attributes:
        mode: ``idle``, ``holding`` or ``released``.
        interface: what the commands are.
        settings: settings of the controller.
        tips: the measured forces of the fingertips; None if they are not measured.
        problem: why the last joint state has no command; empty if it has one.

    Args:
        grasp: the grasp.
        options: how it is controlled.

    Raises:
        InvalidInput: the drives do not take what the interface gives, or no gains suit the sensors.
    """

    def __init__(self, grasp: Grasp, options: HoldOptions) -> None:
        self._grasp, self._options, self._lock = grasp, options, threading.RLock()
        self.interface = _interface_of(grasp, options.interface)
        base = replace(options.settings, period=1.0 / options.rate)
        self.settings = ControlSettings.for_sensors(options.sensors, base, drives=grasp.hand.drives).settings
        self.tips = None if options.tip_force_noise is None else FingertipWrenches(grasp)
        self.mode: Mode = "idle"
        self.problem = ""
        self._sequence = 0
        self._has_command = threading.Event()
        self._sample: JointSample | None = None
        self._stream: ServerStream | None = None
        self._command: RemoteCommand | None = None
        self._reference: Callable[[float], DesiredMotion] = lambda t: BodyMotion(grasp.p_HO, grasp.R_HO)
        self._opening: _Opening | None = None
        self._start: float | None = None  # of the motion, s; None until its first joint state

    @property
    def grasp(self) -> Grasp:
        """The grasp as estimated from the last joint state: posture, pose of the object and contacts."""
        with self._lock:
            return self._grasp if self._command is None else resumed_setup(self._setup(), self._command).grasp

    @property
    def opening(self) -> float:
        """Distance by which a release moves the fingertips from the object, m."""
        return self._options.opening

    @property
    def release_time(self) -> float:
        """Time of a release, s."""
        return self._options.release_time

    @property
    def grasp_joints(self) -> tuple[str, ...]:
        """Names of the hand's joints, in the order of commands."""
        return tuple(self._grasp.hand.joint_names)

    def contact_forces(self) -> dict[str, tuple[Array, Array]]:
        """Return the planned force (3,), N, and moment (3,), N·m, of each finger on the object at its contact, in O."""
        with self._lock:
            if self._command is None:
                return {}
            contacts = self._command.contacts
            padded = contacts.pad(self._command.f)  # (N, 4): f_t1, f_t2, f_n and m_n
            forces = np.einsum("nij,nj->ni", contacts.R_OC, padded[:, :3])
            moments = contacts.R_OC[:, :, 2] * padded[:, 3:]
            return {name: (forces[i], moments[i]) for i, name in enumerate(self._grasp.fingers)}

    def open(self) -> None:
        """Begin to hold the object: the fingertips touch it.

        Raises:
            RequestRefused: no joint state has arrived, or a joint is too far from the posture of the grasp.
        """
        with self._lock:
            if self.mode == "holding":
                return
            if self._sample is None:
                raise RequestRefused("forbidden", "no joint state has arrived")
            far = np.abs(self._sample.q - self._grasp.q)
            worst = int(far.argmax())
            if far[worst] > _LARGEST_POSTURE_ERROR:
                name = self._grasp.hand.joint_names[worst]
                where = f"{name} is {far[worst]:.3g} rad from the posture of the grasp"
                raise RequestRefused("forbidden", f"{where}: at most {_LARGEST_POSTURE_ERROR} are allowed")
            self._command, self._start = None, None
            self._has_command.clear()
            self._reference = lambda t: BodyMotion(self._grasp.p_HO, self._grasp.R_HO)
            self._stream = _start_stream(self._setup())
            self.mode = "holding"

    def wait_for_command(self, timeout: float) -> bool:
        """Wait for the first command since `open`. Return whether there is one.

        Args:
            timeout: longest time to wait, s.
        """
        return self._has_command.wait(timeout)

    def set_slip_margin(self, slip_margin: float) -> None:
        """Squeeze more or less from the next command on.

        Args:
            slip_margin: slip margin that all contacts keep, N, at least 0.

        Raises:
            InvalidInput: out of range.
        """
        with self._lock:
            self.settings = replace(self.settings, slip_margin=arrays.check_number(slip_margin, "slip_margin", minimum=0.0))
            if self.mode == "holding":
                setup = self._setup()
                self._stream = _start_stream(setup if self._command is None else resumed_setup(setup, self._command))

    def follow(self, plan: TimeScaledPlan) -> None:
        """Move the object along a plan that begins at the present grasp, from the next joint state on.

        Args:
            plan: the plan.

        Raises:
            RequestRefused: the hand does not hold the object.
        """
        with self._lock:
            self.check_holding()
            self._reference, self._start = plan.reference(), None

    def check_holding(self) -> None:
        """Raise an error unless the hand holds the object, and a command has been computed.

        Raises:
            RequestRefused: it does not.
        """
        if self.mode != "holding" or self._command is None:
            raise RequestRefused("forbidden", "the hand does not hold the object")

    def release(self) -> None:
        """Open the hand: the fingertips move from the object, and stay there.

        Raises:
            RequestRefused: the hand does not hold the object.
        """
        with self._lock:
            self.check_holding()
            assert self._sample is not None  # after a command
            self._opening = _Opening(self.grasp, self._sample.q, self._options, self.settings)
            self._stream, self._command, self._start, self.mode = None, None, None, "released"

    def step(self, sample: JointSample, pose: PoseSample | None) -> HoldCommand | None:
        """Return the command for a joint state; None while idle, and if the state is refused: `problem` then has the reason.

        Args:
            sample: the measured joints.
            pose: the measured pose of the object, if one arrived since the last joint state.
        """
        with self._lock:
            sample = sample if sample.t else sample._replace(t=time.monotonic())
            rates, self._sample = _rates(sample, self._sample), sample
            self._sequence += 1
            if self.mode == "idle":
                self.problem = ""
                return None
            self._start = sample.t if self._start is None else self._start
            return self._hold(sample, pose) if self.mode == "holding" else self._open(sample, rates)

    def _hold(self, sample: JointSample, pose: PoseSample | None) -> HoldCommand | None:
        """Return the command of the grasp."""
        assert self._stream is not None
        assert self._start is not None
        seen = None if pose is None else PoseMeasurement(pose.t or sample.t, pose.p_HO, pose.R_HO)
        wrenches = None if self.tips is None else self.tips.at(sample.t, sample.q)
        measurement = Measurement(sample.t, sample.q, tip_wrench=wrenches, object=seen)
        state = StreamState(self._sequence, sample.t, measurement, self._reference(sample.t - self._start))
        payload = self._answer(self._stream, state.encode(protocol.MSGPACK))
        if payload is None:
            return None
        record = _COMMANDS.decode(payload)
        self._command = record.unpack(self._grasp)
        self._has_command.set()
        if self.interface == "effort":
            return HoldCommand(np.array(record.torque), record)
        assert record.drive is not None  # the interface was checked
        return HoldCommand(np.array(record.drive["position"]), record)

    def _open(self, sample: JointSample, rates: Array) -> HoldCommand | None:
        """Return the command of the opening hand."""
        assert self._opening is not None
        assert self._start is not None
        desired = self._opening.desired(sample.t - self._start)
        if self.interface == "position":
            return HoldCommand(desired.q, None)
        state = JointState(self._sequence, sample.t, JointMotion(sample.q, rates), desired)
        payload = self._answer(self._opening.stream, state.encode(protocol.MSGPACK))
        return None if payload is None else HoldCommand(np.array(_JOINT_COMMANDS.decode(payload).torque), None)

    def _answer(self, stream: ServerStream, state: bytes) -> bytes | None:
        """Return the encoded command of a stream; None if it refuses the state, with the reason in `problem`."""
        reply = stream.command(state, protocol.MSGPACK)
        if reply.ok:
            self.problem = ""
            return reply.payload
        record: Any = protocol.decode(reply.payload, protocol.MSGPACK)
        self.problem = str(record["message"])
        return None

    def _setup(self) -> StreamSetup:
        """Return the setup of the grasp's stream."""
        return StreamSetup(self._grasp, self.settings, sensors=self._options.sensors)


class _Opening:
    """The motion that opens a hand: each fingertip moves along the outward normal of its contact.

    Args:
        grasp: the grasp as it is.
        q: (n,) measured posture, rad.
        options: how the grasp is controlled.
        settings: settings of the controller; their gravity counts.
    """

    def __init__(self, grasp: Grasp, q: Array, options: HoldOptions, settings: ControlSettings) -> None:
        outward = -grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T  # (N, 3), in H
        self._q = self._q_open = q
        for finger, direction in zip(grasp.fingers, options.opening * outward, strict=True):
            self._q_open = _moved_tip(grasp.hand, finger, direction, self._q_open)
        self._time = options.release_time
        law = JointController.with_frequency(grasp.hand, "computed_torque", _RELEASE_FREQUENCY, settings.gravity_H)
        self.stream = ServerStream("ros2", JointStreamSetup(law, period=settings.period))

    def desired(self, t: float) -> JointMotion:
        """Return the desired motion of the joints.

        Args:
            t: time since the begin, s.
        """
        s, ds, dds = minimum_jerk(max(t, 0.0), self._time)
        way = self._q_open - self._q
        return JointMotion(self._q + s * way, ds * way, dds * way)


def _start_stream(setup: StreamSetup) -> ServerStream:
    """Return the stream of a grasp, whose commands are those of `OutputFeedbackController` to rounding."""
    return ServerStream("ros2", setup, law_type=ObjectControlLaw)


def _moved_tip(hand: Hand, finger: str, way: Array, q: Array) -> Array:
    """Return the posture (n,) in which a fingertip has moved, as far along its way (3,), m, as its joints permit, rad."""
    start = hand.tip_pose(q, finger)[0]
    for share in _SHARES:
        with contextlib.suppress(InvalidInput):  # out of reach
            return hand.tip_posture({finger: start + share * way}, q)
    return q


def _interface_of(grasp: Grasp, interface: Interface | None) -> Interface:
    """Return the interface of a hand's drives, and check that they take it."""
    takes_positions = grasp.hand.drives.has_mode(*_POSITION_MODES)
    if interface == "position" and not takes_positions.all():
        raise InvalidInput("interface", interface, f"effort: the drives of {grasp.hand.name} take no positions")
    return interface or ("position" if takes_positions.all() else "effort")


def _rates(sample: JointSample, last: JointSample | None) -> Array:
    """Return the joint rates: as measured, or by the difference of the last two positions, rad/s."""
    if sample.v is not None:
        return sample.v
    if last is None or sample.t <= last.t:
        return freeze(np.zeros(len(sample.q)))
    return freeze((sample.q - last.q) / (sample.t - last.t))
