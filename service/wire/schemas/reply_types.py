"""Types of the records of replies about hands, grasps, plans and streams. Readers ignore fields that they do not know."""

from __future__ import annotations

from typing import Any, Literal

from msgspec import Struct

from graspforce.service.wire.schemas.array_types import Index, Matrix3, NotNegative, Numbers, Rows, Vector3
from graspforce.service.wire.schemas.object_types import GraspRecord, PoseRecord
from graspforce.service.wire.schemas.solution_types import InfeasibilityRecord, ReplyEnvelope


class FrameRecord(Struct, kw_only=True):
    """The frame of a link.

    Args:
        name: name of the link.
        tip_of: names of the fingers whose tip frame it is.
        position: position in H, m.
        rotation: rotation matrix in H, by rows.
    """

    name: str
    tip_of: list[str]
    position: Vector3
    rotation: Matrix3


class HandReply(ReplyEnvelope, kw_only=True):
    """The reply to `hands/<hand>`.

    Args:
        name: name of the hand.
        title: title of the description.
        source: source of its numbers.
        license: licence of the description.
        notes: remarks.
        base: name of the base link, whose frame is H.
        fingers: fingers: `name`, `joints`, `tip`, `tip_radius` (m) and `torsional_friction` (m).
        joints: joints: `name`, `finger`, `lower` and `upper` (rad), `velocity` (rad/s), `torque` (N·m) and others.
        neutral: neutral posture, rad.
        torque_weight: weights of the squared torques in the cost.
        friction: joint friction: `coulomb`, `stribeck`, `stribeck_velocity`, `viscous` and `sources` by joint.
        drives: drive of each joint.
        couplings: couplings of joints.
        tendons: tendons.
        locked: joints that are locked.
        moving_masses: mass that each joint of the URDF moves, kg.
        replaced_inertias: links whose inertias the description replaces.
        posture: posture of the frames, rad.
        frames: frames of all links in H.
    """

    name: str
    title: str
    source: str
    license: str
    notes: list[str]
    base: str
    fingers: list[dict[str, Any]]
    joints: list[dict[str, Any]]
    neutral: Numbers
    torque_weight: Numbers
    friction: dict[str, Any]
    drives: list[dict[str, Any]]
    couplings: list[dict[str, Any]]
    tendons: list[dict[str, Any]]
    locked: list[dict[str, Any]]
    moving_masses: dict[str, float]
    replaced_inertias: list[dict[str, str]]
    posture: Numbers
    frames: list[FrameRecord]


class TipRecord(Struct, kw_only=True):
    """The tip frame of a finger.

    Args:
        finger: name of the finger.
        position: position in H, m.
        rotation: rotation matrix in H, by rows.
        jacobian: Jacobian of its twist in H, linear rows first.
    """

    finger: str
    position: Vector3
    rotation: Matrix3
    jacobian: Rows


class InverseReply(ReplyEnvelope, kw_only=True):
    """The reply to `hands/<hand>/inverse`.

    Args:
        joints: names of the joints.
        posture: joint positions, rad.
    """

    joints: list[str]
    posture: Numbers


class ForwardReply(InverseReply, kw_only=True):
    """The reply to `hands/<hand>/forward`.

    Args:
        tips: tip frame of each finger.
    """

    tips: list[TipRecord]


class RankedGraspRecord(Struct, kw_only=True):
    """A grasp and its measures.

    Args:
        hold: the grasp.
        margin: largest slip margin of all contacts at once, N.
        robustness: fraction of friction that may be lost.
        clearance: least distance of bodies that must not touch, m; null without shapes.
        seed: seed of the search that found it.
    """

    hold: GraspRecord
    margin: float
    robustness: float
    clearance: float | None
    seed: Index


class GraspReply(ReplyEnvelope, kw_only=True):
    """The reply to `hands/<hand>/grasp`.

    Args:
        id: id of the search.
        hold: the best grasp.
        grasps: all grasps, the best first.
    """

    id: str
    hold: GraspRecord
    grasps: list[RankedGraspRecord]


class PlanRecord(Struct, kw_only=True):
    """A checked motion from rest to rest.

    Args:
        schema: name and version of the record.
        hand: name of the hand.
        joints: names of the joints.
        fingers: names of the fingers in contact.
        contacts: contacts at the start.
        duration: duration, s.
        check: the check between the knots: whether it is `verified`, and the largest excess of each limit.
        gap: bound on the possible reduction of the duration, relative; null for a local optimum.
        stopped: whether the budget or the client ended the search.
        s: path parameters of the knots.
        knots: states at the knots: `times` (s), `q`, `v`, `a`, `tau`, `f` and others.
        effort: time and work of planning.
    """

    schema: Literal["graspforce/plan/1"]
    hand: str | None
    joints: list[str]
    fingers: list[str]
    contacts: list[dict[str, Any]]
    duration: NotNegative
    check: dict[str, Any]
    gap: float | None
    stopped: bool
    s: Numbers
    knots: dict[str, list[Any]]
    effort: dict[str, float]


class FailureRecord(Struct, kw_only=True):
    """The reason why there is no plan.

    Args:
        kind: kind of the failure.
        reason: the reason as text.
        s: path parameter of the place; null if there is no single one.
        joint: name of the joint that causes it.
        infeasibility: proof that the object cannot be held there.
        links: names of two bodies that collide.
        point: point of the collision in H, m.
    """

    kind: str
    reason: str
    s: float | None
    joint: str | None
    infeasibility: InfeasibilityRecord | None
    links: list[str] | None = None
    point: Vector3 | None = None


class PlanReply(ReplyEnvelope, kw_only=True):
    """The reply to `hands/<hand>/plan`: exactly one of `plan` and `refusal` is null.

    Args:
        id: id of the plan.
        plan: the plan.
        refusal: the reason why there is none.
    """

    id: str
    plan: PlanRecord | None
    refusal: FailureRecord | None


class HeldStateRecord(Struct, kw_only=True):
    """Fingers that hold an object at one place of its path.

    Args:
        u: path parameter: radians of turn, or displacement divided by 0.03 m, whichever is larger.
        posture: joint positions, rad.
        fingers: names of the fingers in contact.
        positions: contact points of these fingers in O, m.
        normals: inward normals there, in O.
        tangents: first tangents t₁ there, in O.
    """

    u: NotNegative
    posture: Numbers
    fingers: list[str]
    positions: list[Vector3]
    normals: list[Vector3]
    tangents: list[Vector3]


class ObjectStageRecord(Struct, tag_field="kind", tag="object", kw_only=True):
    """All fingers move the object along a part of its path.

    Args:
        duration: duration, s.
        margin: least slip margin that forces can keep, N.
        states: fingers and object at instants along the path.
    """

    duration: NotNegative
    margin: float
    states: list[HeldStateRecord]


class FingerStageRecord(Struct, tag_field="kind", tag="finger", kw_only=True):
    """One finger steps to another place of the object, which the others hold at rest.

    Args:
        duration: duration of the motion between lift and arrival, s.
        margin: the smaller of the slip margins of the others, and of all fingers at the end, N.
        finger: name of the finger.
        postures: postures of the step, rad.
        end: fingers and object at the end.
    """

    duration: NotNegative
    margin: float
    finger: str
    postures: Rows
    end: HeldStateRecord


class RegraspPlanRecord(Struct, kw_only=True):
    """Object moves and finger steps that bring an object to a pose.

    Args:
        schema: name and version of the record.
        hand: name of the hand.
        duration: duration of all motions, s, without the times in which forces rise and fall.
        margin: least slip margin of all stages, N.
        path: poses of the object in H, of which neighbours are joined by straight lines and turns about one axis.
        stages: object moves and finger steps, in order.
    """

    schema: Literal["graspforce/regrasp/1"]
    hand: str
    duration: NotNegative
    margin: float
    path: list[PoseRecord]
    stages: list[ObjectStageRecord | FingerStageRecord]


class RegraspReply(ReplyEnvelope, kw_only=True):
    """The reply to `hands/<hand>/regrasp`: exactly one of `plan` and `refusal` is null.

    Args:
        id: id of the search.
        plan: the plan.
        refusal: the reason why none was found.
    """

    id: str
    plan: RegraspPlanRecord | None
    refusal: FailureRecord | None


class ProgressRecord(Struct, kw_only=True):
    """Progress of a plan or of a search, published at `plans/<id>/progress`.

    Args:
        id: id of the plan.
        stage: stage of planning.
        fraction: fraction of the stage that is done.
        iteration: number of the iteration.
        best: duration of the best plan so far, s; null before the first.
        seconds: time since the beginning, s.
    """

    id: str
    stage: str
    fraction: NotNegative
    iteration: Index
    best: float | None
    seconds: NotNegative


class OpenedReply(ReplyEnvelope, kw_only=True):
    """The reply to a query that opens a stream.

    Args:
        stream: id of the stream.
        opened: whether it is new; false if it was open with the same setup.
        idle: time without a valid state after which the stream closes, s.
        joints: names of the joints in the order of the torques.
        key: key of the authentication codes, 64 hexadecimal digits, if the stream has them.
        epoch: number of this opening, 16 hexadecimal digits, if the stream has no authentication.
    """

    stream: str
    opened: bool
    idle: NotNegative
    joints: list[str]
    key: str | None = None
    epoch: str | None = None


class SetupReply(ReplyEnvelope, kw_only=True):
    """The reply `setups/<id>`.

    Args:
        stream: id of the stream.
        joints: names of the joints in the order of the torques.
        setup: the record that opened the stream, as in `streams/request`, without proofs.
    """

    stream: str
    joints: list[str]
    setup: dict[str, Any]


class ClosedReply(ReplyEnvelope, kw_only=True):
    """The reply to a query that closes a stream.

    Args:
        stream: id of the stream.
        outcomes: number of states by outcome.
        skipped: states that newer ones replaced before they were read.
    """

    stream: str
    outcomes: dict[str, Index]
    skipped: Index
