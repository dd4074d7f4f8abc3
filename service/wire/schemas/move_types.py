"""Types of the records of moves, for plans."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from graspforce.service.wire.schemas.array_types import NotNegative, Numbers, Positive, Rows, Vector3
from graspforce.service.wire.schemas.object_types import BodyRecord, GraspContactRecord, ObstacleRecord, PoseRecord
from graspforce.service.wire.schemas.request_types import EnvelopeRecord, Limit
from graspforce.service.wire.schemas.settings_types import AccelerationLimitsType


class CollisionsRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """Checks of collisions.

    Args:
        margin: least distance, m.
        obstacles: bodies at rest.
    """

    margin: NotNegative = 0.0
    obstacles: list[ObstacleRecord] = []


class _MoveRequest(EnvelopeRecord, forbid_unknown_fields=True, kw_only=True):
    """Fields of all moves.

    Args:
        id: id of the plan; the server chooses one by default.
        gravity: gravity in H, m/s².
        slip_margin: slip margin of all contacts, N.
        collisions: checks of collisions; false for none.
        acceleration_limits: largest accelerations of object and joints.
        torque: largest torques by joint, N·m.
        speed: largest rates by joint, rad/s.
        lower: smallest joint positions, rad.
        upper: largest joint positions, rad.
        intervals: number of intervals between knots.
        tolerance: largest excess of a limit between knots.
    """

    id: str | None = None
    gravity: Vector3 | None = None
    slip_margin: NotNegative | None = None
    collisions: CollisionsRecord | bool | None = None
    acceleration_limits: AccelerationLimitsType | None = None  # type: ignore[valid-type]
    torque: Numbers | None = None
    speed: Numbers | None = None
    lower: Numbers | None = None
    upper: Numbers | None = None
    intervals: Annotated[int, Meta(ge=2)] | None = None
    tolerance: Positive | None = None


class _ObjectMoveRequest(_MoveRequest, forbid_unknown_fields=True, kw_only=True):
    """Fields of moves of an object.

    Args:
        body: the object.
        contacts: the contacts, in O.
        poses: poses of the object in H, from start to goal.
        posture: posture at the start, rad; by default the nearest to neutral.
        rolling: whether the fingertips roll.
    """

    body: BodyRecord
    contacts: Annotated[list[GraspContactRecord], Meta(min_length=1)]
    poses: Annotated[list[PoseRecord], Meta(min_length=2)]
    posture: Numbers | None = None
    rolling: bool | None = None


class PathMoveRequest(_ObjectMoveRequest, tag_field="method", tag="path", forbid_unknown_fields=True, kw_only=True):
    """The fastest motion of an object along a path.

    Args:
        way: type of the path.
    """

    way: Literal["straight", "screw", "spline"] | None = "straight"


class WorkspaceRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """Bounds of the object's pose; null for no bound.

    Args:
        lower: smallest coordinates of its origin in H, m.
        upper: largest coordinates of its origin in H, m.
        turn: largest rotation about each axis beyond the range between start and goal, rad.
    """

    lower: Limit | None = None
    upper: Limit | None = None
    turn: NotNegative | None = None


class FreeMoveRequest(_ObjectMoveRequest, tag_field="method", tag="free", forbid_unknown_fields=True, kw_only=True):
    """The fastest motion of an object whose path is free.

    Args:
        room: bounds of the object's pose.
    """

    room: WorkspaceRecord | None = None


class FingersMoveRequest(_MoveRequest, tag_field="method", tag="fingers", forbid_unknown_fields=True, kw_only=True):
    """The fastest motion of the fingers without an object.

    Args:
        postures: postures at start and goal, rad.
        apart: least distance of the fingertips, m.
        obstacles: bodies at rest.
    """

    postures: Rows
    apart: NotNegative | None = None
    obstacles: list[ObstacleRecord] | None = None
