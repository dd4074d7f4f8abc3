"""Messages of the node: joints, poses and forces in; commands, plans and diagnostics out. Frames: H hand base, O object."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.estimation.measurement import LARGEST
from graspforce.geometry.rotations import rotation_from_quaternion
from graspforce.planning.trajectory import Trajectory
from graspforce.service.ros2.interfaces import make

JOINT_STATE = "sensor_msgs/msg/JointState"
POSE = "geometry_msgs/msg/PoseStamped"
WRENCH = "geometry_msgs/msg/WrenchStamped"
NUMBERS = "std_msgs/msg/Float64MultiArray"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
TRIGGER = "std_srvs/srv/Trigger"
GRIPPER = "control_msgs/action/GripperCommand"

OK, WARN, ERROR, STALE = range(4)
"""Levels of diagnostics."""

_NANO = 1e-9
_NS = 10**9


class JointSample(NamedTuple):
    """Measured joints of a hand.

    Attributes:
        t: time of the measurement on the clock of its sender, s; 0 if the message has none.
        q: (n,) positions, rad.
        v: (n,) rates, rad/s; None if not measured.
        tau: (n,) torques, N·m; None if not measured.
    """

    t: float
    q: Array
    v: Array | None
    tau: Array | None


def read_joints(message: Any, joints: Sequence[str], start: int) -> JointSample:
    """Return the joints of a hand from a joint state, which may have others, in any order.

    Args:
        message: a message `JOINT_STATE`.
        joints: names of the hand's joints in their order.
        start: time that counts as zero, ns: numbers near zero are exact.

    Raises:
        InvalidInput: a joint is missing, or a position is not finite; names it.
    """
    places = {name: i for i, name in enumerate(message.name)}
    missing = [name for name in joints if name not in places]
    if missing:
        raise InvalidInput("name", list(message.name), f"with the joints of the hand; {', '.join(missing)} missing")
    chosen = [places[name] for name in joints]
    rows: list[Array | None] = []
    for field in ("position", "velocity", "effort"):
        values = getattr(message, field)
        if len(values) not in (0, len(places)) or (field == "position" and not len(values)):
            raise InvalidInput(field, f"{len(values)} numbers", f"{len(places)}, one for each joint")
        given = np.asarray(values, dtype=np.float64)[chosen] if len(values) else None
        # NaN stands for a quantity that is not measured
        is_measured = given is not None and (field == "position" or not np.isnan(given).any())
        rows.append(arrays.check_array(given, field, (len(joints),)) if is_measured else None)
    q, v, tau = rows
    assert q is not None  # positions are required
    return JointSample(_seconds(message.header, start), q, v, tau)


class PoseSample(NamedTuple):
    """A measured or desired pose of the object in H.

    Attributes:
        t: time of the image on the clock of its sender, s; 0 if the message has none.
        p_HO: (3,) position, m.
        R_HO: (3, 3) rotation matrix.
    """

    t: float
    p_HO: Array
    R_HO: Array


def read_pose(message: Any, frame: str, start: int) -> PoseSample:
    """Return the pose of a message.

    Args:
        message: a message `POSE`.
        frame: name of the frame in which poses must be; empty for any.
        start: time that counts as zero, ns.

    Raises:
        InvalidInput: the pose is in another frame, or a number is not allowed.
    """
    given = message.header.frame_id
    if frame and given != frame:
        raise InvalidInput("header.frame_id", given, f"{frame!r}, the base frame of the hand")
    p, turn = message.pose.position, message.pose.orientation
    R = rotation_from_quaternion([turn.w, turn.x, turn.y, turn.z], "pose.orientation")
    return PoseSample(_seconds(message.header, start), arrays.check_array([p.x, p.y, p.z], "pose.position", (3,)), R)


class WrenchSample(NamedTuple):
    """A measured wrench of a finger on the object.

    Attributes:
        force: (3,) N.
        moment: (3,) about the contact point, N·m.
        is_in_tip: whether both are in the frame of the fingertip; else in H.
    """

    force: Array
    moment: Array
    is_in_tip: bool


def read_wrench(message: Any, base_frames: Collection[str], tip: str) -> WrenchSample:
    """Return the wrench of a message.

    Args:
        message: a message `WRENCH`.
        base_frames: names of the frame H.
        tip: name of the fingertip's frame.

    Raises:
        InvalidInput: the wrench is in another frame, or a number is not finite or beyond the range of measurements.
    """
    given = message.header.frame_id
    if given != tip and given not in base_frames:
        allowed = ", ".join(sorted(map(repr, base_frames)))
        raise InvalidInput("header.frame_id", given, f"{tip!r}, the fingertip, or the base of the hand: {allowed}")
    force, moment = ([part.x, part.y, part.z] for part in (message.wrench.force, message.wrench.torque))
    checked = arrays.check_array(force, "wrench.force", (3,)), arrays.check_array(moment, "wrench.torque", (3,))
    for values, field in zip(checked, ("wrench.force", "wrench.torque"), strict=True):
        if np.abs(values).max() > LARGEST:
            raise InvalidInput(field, values.tolist(), f"numbers from −{LARGEST:g} to {LARGEST:g}")
    return WrenchSample(*checked, given == tip)


def make_numbers(values: Array) -> Any:
    """Return a message `NUMBERS`.

    Args:
        values: (n,) numbers.
    """
    return make(NUMBERS, layout=make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0), data=values)


def make_wrench(force: Array, moment: Array, frame: str, time: int) -> Any:
    """Return a message `WRENCH`.

    Args:
        force: (3,) N.
        moment: (3,) N·m.
        frame: frame of both.
        time: ns since 1970.
    """
    wrench = make("geometry_msgs/msg/Wrench", force=_vector(force), torque=_vector(moment))
    return make(WRENCH, header=_header(frame, time), wrench=wrench)


def make_trajectory(joints: Sequence[str], knots: Trajectory, time_scale: float, time: int) -> Any:
    """Return a message `TRAJECTORY` with the joints of a plan.

    Args:
        joints: names of the joints.
        knots: states at the knots of the plan.
        time_scale: σ; the motion takes σ times as long.
        time: ns since 1970.
    """
    points = [
        make(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=knots.q[k],
            velocities=knots.v[k] / time_scale,
            accelerations=knots.a[k] / time_scale**2,
            effort=knots.tau[k],
            time_from_start=_stamp("builtin_interfaces/msg/Duration", round(time_scale * float(t) * _NS)),
        )
        for k, t in enumerate(knots.times)
    ]
    return make(TRAJECTORY, header=_header("", time), joint_names=list(joints), points=points)


def make_diagnostics(level: int, name: str, text: str, values: Mapping[str, object], time: int) -> Any:
    """Return a message `DIAGNOSTICS` with one status.

    Args:
        level: `OK`, `WARN`, `ERROR` or `STALE`.
        name: name of the status.
        text: its message.
        values: further values by name.
        time: ns since 1970.
    """
    pairs = [make("diagnostic_msgs/msg/KeyValue", key=key, value=str(value)) for key, value in values.items()]
    status = make("diagnostic_msgs/msg/DiagnosticStatus", level=level, name=name, message=text, hardware_id=name, values=pairs)
    return make(DIAGNOSTICS, header=_header("", time), status=[status])


def make_response(is_done: bool, text: str) -> Any:
    """Return the response of a service `TRIGGER`.

    Args:
        is_done: whether the request was carried out.
        text: what was done, or why not.
    """
    return make(f"{TRIGGER}_Response", success=is_done, message=text)


def make_gripper_result(position: float, effort: float, is_reached: bool) -> Any:
    """Return the result of an action `GRIPPER`.

    Args:
        position: opening of the hand, m; 0 while it holds an object.
        effort: largest contact force, N.
        is_reached: whether the goal was reached.
    """
    return make(f"{GRIPPER}_Result", position=position, effort=effort, stalled=False, reached_goal=is_reached)


def _seconds(header: Any, start: int) -> float:
    """Return the time of a header since the start, s; 0 if it has none."""
    time = int(header.stamp.sec) * _NS + int(header.stamp.nanosec)
    return (time - start) * _NANO if time else 0.0


def _header(frame: str, time: int) -> Any:
    """Return a header."""
    return make("std_msgs/msg/Header", stamp=_stamp("builtin_interfaces/msg/Time", time), frame_id=frame)


def _stamp(name: str, time: int) -> Any:
    """Return a time or a duration of ns."""
    return make(name, sec=time // _NS, nanosec=time % _NS)


def _vector(values: Array) -> Any:
    """Return a vector."""
    x, y, z = values.tolist()
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
