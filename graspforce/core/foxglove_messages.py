"""Foxglove's messages of poses, joints, contact forces and friction cones, for MCAP files. It needs foxglove-sdk."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from graspforce.core.arrays import Array

NANOSECONDS = 1e9  # of a second
_CONE_OPACITY = 0.45
_HEAD = 4.4  # diameter and length of an arrow's head, over the diameter of its shaft


class ForceMark(Protocol):
    """A contact: the arrow of its force and its friction cone.

    Attributes:
        finger: name of the finger.
        touching: whether the finger touches.
        apex: (3,) the contact point, m.
        R_HC: (3, 3) contact frame; the third axis points into the object.
        arrow: (3,) from the contact point to the arrow's tip, m.
        radius: of the arrow's shaft, m.
        height: of the cone, m.
        mu: coefficient of friction.
        colour: (3,) red, green, blue, 0 to 1.
    """

    @property
    def finger(self) -> str: ...  # pragma: no cover
    @property
    def touching(self) -> bool: ...  # pragma: no cover
    @property
    def apex(self) -> Array: ...  # pragma: no cover
    @property
    def R_HC(self) -> Array: ...  # pragma: no cover
    @property
    def arrow(self) -> Array: ...  # pragma: no cover
    @property
    def radius(self) -> float: ...  # pragma: no cover
    @property
    def height(self) -> float: ...  # pragma: no cover
    @property
    def mu(self) -> float: ...  # pragma: no cover
    @property
    def colour(self) -> Array: ...  # pragma: no cover


def log_time(t: float) -> int:
    """Return a time in whole nanoseconds.

    Args:
        t: the time, s.
    """
    return round(NANOSECONDS * t)


def timestamp(t: float) -> Any:
    """Return the message of a time.

    Args:
        t: the time, s.
    """
    from foxglove import messages

    seconds, nanoseconds = divmod(log_time(t), round(NANOSECONDS))
    return messages.Timestamp(seconds, nanoseconds)


def colour(red_green_blue: Array, opacity: float = 1.0) -> Any:
    """Return the message of a colour.

    Args:
        red_green_blue: (3,) 0 to 1.
        opacity: 0 to 1.
    """
    from foxglove import messages

    red, green, blue = red_green_blue.tolist()
    return messages.Color(r=red, g=green, b=blue, a=opacity)


def pose(p: Array, R: Array) -> Any:
    """Return the message of a pose.

    Args:
        p: (3,) position, m.
        R: (3, 3) rotation.
    """
    from foxglove import messages

    return messages.Pose(position=messages.Vector3(**xyz(p)), orientation=quaternion(R))


def pose_in_frame(t: float, frame: str, p: Array, R: Array) -> Any:
    """Return the message of a pose with its time and frame.

    Args:
        t: time, s.
        frame: name of the frame.
        p: (3,) position in the frame, m.
        R: (3, 3) rotation in the frame.
    """
    from foxglove import messages

    return messages.PoseInFrame(timestamp=timestamp(t), frame_id=frame, pose=pose(p, R))


def transform(t: float, parent: str, child: str, p: Array, R: Array) -> Any:
    """Return the message of a frame in another frame.

    Args:
        t: time, s.
        parent: name of the other frame.
        child: name of the frame.
        p: (3,) its origin in the other frame, m.
        R: (3, 3) its rotation in the other frame.
    """
    from foxglove import messages

    return messages.FrameTransform(
        timestamp=timestamp(t),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=messages.Vector3(**xyz(p)),
        rotation=quaternion(R),
    )


def joint_states(t: float, names: Sequence[str], q: Array, v: Array, tau: Array) -> Any:
    """Return the message of joints.

    Args:
        t: time, s.
        names: names of the n joints.
        q: (n,) positions, rad.
        v: (n,) rates, rad/s.
        tau: (n,) torques, N·m.
    """
    from foxglove import messages

    columns = zip(names, q.tolist(), v.tolist(), tau.tolist(), strict=True)
    joints = [messages.JointState(name=name, position=p, velocity=rate, effort=effort) for name, p, rate, effort in columns]
    return messages.JointStates(timestamp=timestamp(t), joints=joints)


def contact_entity(t: float, frame: str, mark: ForceMark) -> Any:
    """Return arrow and cone of a contact; an entity without parts if the finger does not touch.

    Args:
        t: time, s.
        frame: name of the frame of the mark's vectors.
        mark: the contact.
    """
    from foxglove import messages

    entity = {"timestamp": timestamp(t), "frame_id": frame, "id": mark.finger}
    if not mark.touching:
        return messages.SceneEntity(**entity)
    length, diameter = float(np.linalg.norm(mark.arrow)), 2.0 * mark.radius
    head = min(_HEAD * mark.radius, 0.5 * length)  # m
    arrow = messages.ArrowPrimitive(
        pose=pose(mark.apex, _frame_along(mark.arrow)),
        shaft_length=length - head,
        shaft_diameter=diameter,
        head_length=head,
        head_diameter=_HEAD * mark.radius,
        color=colour(mark.colour),
    )
    width = 2.0 * mark.mu * mark.height  # m
    cone = messages.CylinderPrimitive(
        pose=pose(mark.apex + 0.5 * mark.height * mark.R_HC[:, 2], mark.R_HC),
        size=messages.Vector3(x=width, y=width, z=mark.height),
        bottom_scale=0.0,
        top_scale=1.0,
        color=colour(mark.colour, _CONE_OPACITY),
    )
    return messages.SceneEntity(**entity, arrows=[arrow], cylinders=[cone])


def xyz(p: Array) -> dict[str, float]:
    """Return coordinates by name.

    Args:
        p: (3,) coordinates.
    """
    return dict(zip("xyz", np.asarray(p).tolist(), strict=True))


def quaternion(R: Array) -> Any:
    """Return the message of a rotation.

    Args:
        R: (3, 3) rotation.
    """
    from foxglove import messages
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(R).as_quat().tolist()
    return messages.Quaternion(x=x, y=y, z=z, w=w)


def _frame_along(direction: Array) -> Array:
    """Return a frame whose first axis has a direction; arrows point along it."""
    norm = float(np.linalg.norm(direction))
    x = direction / norm if norm > 0.0 else np.array([1.0, 0.0, 0.0])
    y = np.cross(np.eye(3)[int(np.argmin(np.abs(x)))], x)
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])
