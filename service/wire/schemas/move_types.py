"""Types of the records of moves, for plans."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from graspforce.service.wire.schemas.array_types import NotNegative, Numbers, Positive, Rows, Vector3
from graspforce.service.wire.schemas.object_types import (
    BodyRecord,
    GraspContactRecord,
    GraspRecord,
    ObstacleRecord,
    PoseRecord,
)
from graspforce.service.wire.schemas.request_types import EnvelopeRecord, Limit
from graspforce.service.wire.schemas.settings_types import AccelerationLimitsType, ControlSettingsType


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


class RegraspSearchRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """Settings of the search for a regrasp.

    Args:
        margin: least slip margin of all fingers, and of the others while one steps, N; by default 1.2 times that of the
            controller.
        spacing: least distance between two tips on the object, m.
        advance: turn of the object that a finger should allow at its new place, rad.
        candidates: number of places that are compared in each step of a finger.
        branches: number of them that are tried, best first.
        seed: seed of the random places.
        object_rate: largest rate of the object, rad/s.
        joint_rate: largest rate of joints of stepping fingers, rad/s.
        torque_rate: largest rate of the torques that accelerate a stepping finger, N·m/s.
    """

    margin: Positive | None = None
    spacing: NotNegative | None = 0.002
    advance: Positive | None = 0.6
    candidates: Annotated[int, Meta(ge=1, le=1000)] | None = 24
    branches: Annotated[int, Meta(ge=1, le=100)] | None = 4
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] | None = 0
    object_rate: Positive | None = 0.8
    joint_rate: Positive | None = 2.0
    torque_rate: Positive | None = 5.0


class RegraspRequest(EnvelopeRecord, forbid_unknown_fields=True, kw_only=True):
    """The request `hands/<hand>/regrasp`: a goal pose of a held object, which may be out of reach of one grasp.

    Args:
        hold: the grasp at the start, with all fingers that may be used; the object has a shape.
        goal: pose of the object at the goal, in H.
        id: id by which any client can follow and cancel the search.
        settings: controller settings; slip margin, friction reserve, errors of friction and normals, and gravity count.
        collisions: obstacles and the distance that bodies keep; false for no checks.
        search: settings of the search.
    """

    hold: GraspRecord
    goal: PoseRecord
    id: str | None = None
    settings: ControlSettingsType | None = None  # type: ignore[valid-type]
    collisions: CollisionsRecord | bool | None = None
    search: RegraspSearchRecord | None = None
