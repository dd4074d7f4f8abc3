"""Types of the records of requests, apart from streams. A description with no unit is a name, a choice or a count."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from graspforce.force.problem_options import MAX_FACETS
from graspforce.grasp.search import GraspClass, GraspRank
from graspforce.service.wire import protocol
from graspforce.service.wire.memory_records import ControlMemoryRecord
from graspforce.service.wire.schemas.array_types import (
    NotNegative,
    Numbers,
    Positive,
    Rows,
    Vector3,
    Vector6,
)
from graspforce.service.wire.schemas.object_types import (
    BodyRecord,
    ContactRecord,
    GraspContactRecord,
    GraspRecord,
    PoseRecord,
    ShapeType,
)
from graspforce.service.wire.schemas.settings_types import ControlSettingsType, UncertaintyType

Limit = Annotated[list[float | None], Meta(description="one for each joint; null for no limit")]
Sequence = Annotated[int, Meta(ge=0, le=protocol.LARGEST_SEQUENCE)]


class EnvelopeRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """A request.

    Args:
        sequence: number of the client; the reply repeats it.
        budget: time in which the reply is useful, s, from when the server receives the request.
    """

    sequence: Sequence | None = None
    budget: Positive | None = None


class StatusRequest(EnvelopeRecord, forbid_unknown_fields=True, kw_only=True):
    """The request `status`."""


class SetupQuery(EnvelopeRecord, forbid_unknown_fields=True, kw_only=True):
    """The request `setups/<id>`."""


class HandRequest(EnvelopeRecord, forbid_unknown_fields=True, kw_only=True):
    """The request `hands/<hand>`.

    Args:
        posture: joint positions for the poses of the frames, rad; null for the neutral posture.
    """

    posture: Numbers | None = None


class ActuationRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """The hand of a force problem.

    Args:
        jacobian: contact Jacobian, a row for each force component and a column for each motor.
        bias_torque: torques that the hand needs without contact, N·m; zero by default.
        torque_lower: smallest torques, N·m.
        torque_upper: largest torques, N·m.
        torque_weight: weights of the squared torques in the cost.
    """

    jacobian: Rows
    bias_torque: Numbers | None = None
    torque_lower: Limit | None = None
    torque_upper: Limit | None = None
    torque_weight: Numbers | None = None


class ConeRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """The model of the friction cones.

    Args:
        type: exact cones, or pyramids.
        facets: number of facets of a pyramid.
        side: pyramids inside or outside the exact cones.
    """

    type: Literal["exact", "pyramid"]
    facets: Annotated[int, Meta(ge=3, le=MAX_FACETS)] = 8
    side: Literal["inner", "outer"] = "inner"


class ObjectiveRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """The objective; all are minimised but the margin.

    Args:
        type: the objective.
        force_weight: ρ of the term ½ρ‖f‖² beside torques, (N·m/N)².
        moment_length: length that weighs moments of soft contacts in ‖f‖², m.
    """

    type: Literal["torque", "force", "max_normal", "sum_normal", "margin"]
    force_weight: NotNegative = 0.0
    moment_length: Positive = 1.0


class ProblemRequest(EnvelopeRecord, forbid_unknown_fields=True, kw_only=True):
    """A force problem.

    Args:
        schema: name and version of the record.
        contacts: the contacts, in O.
        wrench: wrench that the contacts must supply, about O's origin, in O, linear first, N and N·m.
        name: name of the problem.
        source: where it is from.
        hand: contact Jacobian and torque limits; null for forces without a hand.
        cone: model of the friction cones.
        objective: cost; torque with a hand, otherwise force.
        uncertainty: errors that the forces must survive.
        expected: expected result of a library's problem; it has no effect.
    """

    schema: Literal["graspforce/problem/1"]
    contacts: Annotated[list[ContactRecord], Meta(min_length=1)]
    wrench: Vector6
    name: str | UnsetType = UNSET
    source: str | UnsetType = UNSET
    hand: ActuationRecord | None = None
    cone: ConeRecord | None = None
    objective: ObjectiveRecord | None = None
    uncertainty: UncertaintyType | None = None  # type: ignore[valid-type]
    expected: Any = None


class SolveRequest(ProblemRequest, forbid_unknown_fields=True, kw_only=True):
    """The request `solve`: a force problem.

    Args:
        backend: name of the solver; null for the server's choice.
    """

    backend: str | None = None


class AnalysisRequest(ProblemRequest, forbid_unknown_fields=True, kw_only=True):
    """The requests `quality` and `explain`: a force problem.

    Args:
        direction: direction of the payload: a force and a moment about O, in O; null for the wrench.
    """

    direction: Vector6 | None = None


class QualityRequest(AnalysisRequest, forbid_unknown_fields=True, kw_only=True):
    """The request `quality`.

    Args:
        shape: surface of the object in O, to compute the regions of contacts on it; null for none.
    """

    shape: ShapeType | None = None


class ForwardRequest(EnvelopeRecord, forbid_unknown_fields=True, kw_only=True):
    """The request `hands/<hand>/forward`.

    Args:
        posture: joint positions, rad.
    """

    posture: Numbers


class InverseRequest(EnvelopeRecord, forbid_unknown_fields=True, kw_only=True):
    """The request `hands/<hand>/inverse`.

    Args:
        tips: position of each named finger's tip frame in H, m.
        start: posture to start from, rad.
    """

    tips: Annotated[dict[str, Vector3], Meta(min_length=1)]
    start: Numbers | None = None


class GraspSearchRequest(EnvelopeRecord, forbid_unknown_fields=True, kw_only=True):
    """The request `hands/<hand>/grasp`.

    Args:
        body: the object.
        id: id by which any client can cancel the search.
        friction: μ of all contacts.
        gravity: one or several accelerations of gravity in H, m/s², each a load case; null for the six directions of the axes.
        fingers: names of the fingers that touch; null for the search's choice.
        seed: seed of the random candidates.
        count: number of different grasps.
        rank: measure that orders them.
        max_normal: largest normal force, N.
        slip_margin: slip margin of the forces, N.
        travel: travel of the fingertips that the grasp must leave, m.
        clearance: least distance of bodies that must not touch, m.
        edge_ratio: least distance of a contact from an edge, as a fraction of the tip's radius.
        palm_normal_H: normal of the palm in H.
        grasp_class: class of the grasp, by name.
        approach_O: direction of approach in O.
        up_O: direction in O that is up.
        pad_friction: whether the pads' torsional friction counts.
    """

    body: BodyRecord
    id: str | None = None
    friction: Positive | None = 0.6
    gravity: list[float | Vector3] | None = None
    fingers: Annotated[list[str], Meta(min_length=2)] | None = None
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] | None = 0
    count: Annotated[int, Meta(ge=1, le=16)] | None = 1
    rank: GraspRank | None = GraspRank.MARGIN
    max_normal: Positive | None = 20.0
    slip_margin: NotNegative | None = 0.05
    travel: NotNegative | None = None
    clearance: NotNegative | None = 0.002
    edge_ratio: NotNegative | None = 0.4
    palm_normal_H: Vector3 | None = None
    grasp_class: GraspClass | None = None
    approach_O: Vector3 | None = None
    up_O: Vector3 | None = None
    pad_friction: Positive | None = None


class DistributeRequest(EnvelopeRecord, forbid_unknown_fields=True, kw_only=True):
    """The request `hands/<hand>/distribute`.

    Args:
        posture: joint positions, rad.
        object: pose of the object in H.
        contacts: the contacts, in O.
        wrench: wrench that the contacts must supply, about O's origin, in O, N and N·m.
        gravity: gravity in H, m/s².
        velocity: joint rates, rad/s.
        acceleration: joint accelerations, rad/s².
        cone: model of the friction cones.
        objective: cost.
        uncertainty: errors that the forces must survive.
        backend: name of the solver; null for the server's choice.
    """

    posture: Numbers
    object: PoseRecord
    contacts: Annotated[list[GraspContactRecord], Meta(min_length=1)]
    wrench: Vector6
    gravity: Vector3 | None = None
    velocity: Numbers | None = None
    acceleration: Numbers | None = None
    cone: ConeRecord | None = None
    objective: ObjectiveRecord | None = None
    uncertainty: UncertaintyType | None = None  # type: ignore[valid-type]
    backend: str | None = None


class ObjectStateRecord(PoseRecord, forbid_unknown_fields=True, kw_only=True):
    """Pose and twist of an object in H.

    Args:
        twist: linear and angular velocity, m/s and rad/s; zero by default.
    """

    twist: Vector6 | None = None


class StateRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """State of hand and object.

    Args:
        posture: joint positions, rad.
        object: pose and twist of the object in H.
        velocity: joint rates, rad/s; zero by default.
    """

    posture: Numbers
    object: ObjectStateRecord
    velocity: Numbers | None = None


class JointMotionRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """Motion of the joints.

    Args:
        posture: positions, rad.
        velocity: rates, rad/s; zero by default.
        acceleration: accelerations, rad/s²; zero by default.
    """

    posture: Numbers
    velocity: Numbers | None = None
    acceleration: Numbers | None = None


class DesiredRecord(ObjectStateRecord, forbid_unknown_fields=True, kw_only=True):
    """Desired motion of the object in H.

    Args:
        acceleration: linear and angular acceleration, m/s² and rad/s²; zero by default.
        joints: desired motion of redundant joints.
    """

    acceleration: Vector6 | None = None
    joints: JointMotionRecord | None = None


class ControlRequest(EnvelopeRecord, forbid_unknown_fields=True, kw_only=True):
    """The request `hands/<hand>/control`: one control step.

    Args:
        hold: the grasp.
        state: measured state of hand and object.
        desired: desired motion.
        settings: controller settings.
        external: estimated wrench on the object apart from gravity and finger forces, about O's origin, in O, N and N·m.
        memory: `memory` of the last reply; null for a first step.
    """

    hold: GraspRecord
    state: StateRecord
    desired: DesiredRecord
    settings: ControlSettingsType | None = None  # type: ignore[valid-type]
    external: Vector6 | None = None
    memory: ControlMemoryRecord | None = None
