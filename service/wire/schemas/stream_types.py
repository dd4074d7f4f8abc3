"""Types of the records of streams: setups and states."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct, field

from graspforce.service.wire.control_records import DEFAULT_TORQUE_STEP, DEFAULT_VALIDITY
from graspforce.service.wire.joint_records import DEFAULT_PERIOD, LAWS
from graspforce.service.wire.memory_records import ControlMemoryRecord
from graspforce.service.wire.schemas.array_types import Index, Matrix6, Numbers, Positive, Rows, Rows3, Rows6, Vector3, Vector6
from graspforce.service.wire.schemas.object_types import GraspContactRecord, GraspRecord, PoseRecord
from graspforce.service.wire.schemas.request_types import (
    DesiredRecord,
    EnvelopeRecord,
    JointMotionRecord,
    Sequence,
    StateRecord,
)
from graspforce.service.wire.schemas.settings_types import ControlSettingsType, PhaseSettingsType, SensorsType


class _SetupRequest(EnvelopeRecord, forbid_unknown_fields=True, kw_only=True):
    """Fields of all setups.

    Args:
        hand: name of a served hand.
        validity: largest age of a good command, s, from when its state was sent.
        authenticated: whether states and commands have authentication codes.
        proof: proof that the client opened the stream, in hexadecimal, to open it again from another session; or several,
            of all openings, the newest first.
    """

    hand: str
    validity: Positive | None = DEFAULT_VALIDITY
    authenticated: bool | None = False
    proof: str | list[str] | None = None


class ControlSetup(_SetupRequest, forbid_unknown_fields=True, kw_only=True):
    """Opens a stream that controls a held object.

    Args:
        hold: the grasp.
        kind: kind of the stream.
        settings: controller settings; their period is the stream's.
        memory: `memory` of the last command of an earlier stream; null for a new start.
        sensors: sensors of the hand. If given, the states are measurements.
        offset: offset of the object from its pose in the grasp, from an earlier stream.
        change_number: number of the last change of contacts of an earlier stream.
        torque_step: largest change of a joint's torque from command to command, as a fraction of half its torque range.
    """

    hold: GraspRecord
    kind: Literal["control"] = "control"
    settings: ControlSettingsType | None = None  # type: ignore[valid-type]
    memory: ControlMemoryRecord | None = None
    sensors: SensorsType | None = None  # type: ignore[valid-type]
    offset: PoseRecord | None = None
    change_number: Index | None = 0
    torque_step: Annotated[float, Meta(gt=0, le=2)] | None = DEFAULT_TORQUE_STEP


class TrajectoryRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """A motion of the joints through knots.

    Args:
        times: times of the knots, s.
        posture: positions at each knot, rad.
        velocity: rates at each knot, rad/s.
        acceleration: accelerations at each knot, rad/s².
    """

    times: Numbers
    posture: Rows
    velocity: Rows
    acceleration: Rows


class MotionProfileRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """The share of a straight displacement over time, from rest to rest, through knots.

    Args:
        times: times of the knots, s, increasing from 0.
        share: share of the displacement at each knot, from 0 to 1.
        rate: its rate, 1/s; 0 at both ends.
        acceleration: its second derivative, 1/s².
    """

    times: Numbers
    share: Numbers
    rate: Numbers
    acceleration: Numbers


class CarryProfilesRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """Time profiles of the hand's base while the object is held.

    Args:
        lift: from the table to the lift height.
        move: from there to above the goal.
        place: from there back to the table.
    """

    lift: MotionProfileRecord
    move: MotionProfileRecord
    place: MotionProfileRecord


class CyclePlanRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """A grasp from a table and back.

    Args:
        hold: the grasp, with the object where it is expected on the table.
        gravity: acceleration of gravity in H, m/s²; the table's normal is opposite.
        pregrasp: posture before the guarded close, rad.
        standoff: distance of each fingertip from its contact in that posture, m.
        approach: motion from the start posture to `pregrasp`.
        lift: displacement of the hand's base that lifts the object, in H, m.
        move: displacement from there to above the goal, in H, m.
        profiles: time profiles of these displacements; least jerk with a mean speed of 0.1 m/s by default.
    """

    hold: GraspRecord
    gravity: Vector3
    pregrasp: Numbers
    standoff: Numbers
    approach: TrajectoryRecord
    lift: Vector3 = field(default_factory=lambda: [0.0, 0.0, 0.0])
    move: Vector3 = field(default_factory=lambda: [0.0, 0.0, 0.0])
    profiles: CarryProfilesRecord | None = None


class PhaseSetup(_SetupRequest, tag_field="kind", tag="phases", forbid_unknown_fields=True, kw_only=True):
    """Opens a stream of the phases of a grasp.

    Args:
        plan: the plan.
        phases: settings of the phases.
        sensors: sensors of the hand; their rate is the stream's.
        settings: settings of the object controller.
    """

    plan: CyclePlanRecord
    phases: PhaseSettingsType | None = None  # type: ignore[valid-type]
    sensors: SensorsType | None = None  # type: ignore[valid-type]
    settings: ControlSettingsType | None = None  # type: ignore[valid-type]


class JointSetup(_SetupRequest, tag_field="kind", tag="joints", forbid_unknown_fields=True, kw_only=True):
    """Opens a stream of a joint-space law, with either `gains` or `frequency`.

    Args:
        law: name of the law.
        gains: gains by name, one number for each joint: kp and kv; kp, ki and kd for pid; kp, ki and kv for force.
        frequency: natural frequency of all joints, Hz, for a law of motion.
        gravity: acceleration of gravity in H, m/s².
        period: control period, s.
        integral: integral of an earlier stream, N·m.
    """

    law: Literal[LAWS]  # type: ignore[valid-type]
    gains: dict[Literal["kp", "kv", "ki", "kd"], Numbers] | None = None
    frequency: Positive | None = None
    gravity: Vector3 | None = None
    period: Positive | None = DEFAULT_PERIOD
    integral: Numbers | None = None


class CloseRequest(EnvelopeRecord, forbid_unknown_fields=True, kw_only=True):
    """Closes a stream.

    Args:
        close: true.
        proof: proof that the client opened the stream, in hexadecimal, from another session; or several, the newest first.
    """

    close: bool
    proof: str | list[str] | None = None


class PoseMeasurementRecord(PoseRecord, forbid_unknown_fields=True, kw_only=True):
    """A measured pose of the object in H.

    Args:
        t: time of the image, s.
        covariance: covariance of position and rotation, m², m·rad and rad².
    """

    t: float
    covariance: Matrix6 | None = None


class MeasurementRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """What a hand measured.

    Args:
        t: time of the joint positions, s.
        posture: joint positions, rad.
        velocity: joint rates, rad/s.
        torque: joint torques, N·m.
        current: motor currents, A.
        tip_wrenches: force and moment of each finger on the object at its contact, in H, N and N·m.
        contact_points: contact points in H, m.
        object: pose of the object, if one arrived.
    """

    t: float
    posture: Numbers
    velocity: Numbers | None = None
    torque: Numbers | None = None
    current: Numbers | None = None
    tip_wrenches: Rows6 | None = None
    contact_points: Rows3 | None = None
    object: PoseMeasurementRecord | None = None


class ConditionsRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """Conditions of the contacts that differ from the model.

    Args:
        slipping: whether each contact slips.
        friction: lower bound of each contact's friction coefficient.
        lost: names of fingers whose drives are off.
        touching: whether each contact touches.
        fingers: names of the fingers in the order of the other fields; by default those of the present contacts.
    """

    slipping: list[bool] | None = None
    friction: Numbers | None = None
    lost: list[str] | None = None
    touching: list[bool] | None = None
    fingers: list[str] | None = None


class ChangeRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """A change of contacts to begin.

    Args:
        number: number of the change, from 1; it grows from change to change.
        release: names of the fingers that let go.
        add: contacts of the fingers that join.
        force_rate: rate of their normal forces, N/s.
    """

    number: Annotated[int, Meta(ge=1)]
    release: list[str] | None = None
    add: list[GraspContactRecord] | None = None
    force_rate: Positive | None = None


class _StampedRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """Fields of all states.

    Args:
        sequence: number of the state; the command repeats it.
        time: when it was sent, on the sender's clock, s; the command repeats it.
    """

    sequence: Sequence
    time: float


class ControlState(_StampedRecord, forbid_unknown_fields=True, kw_only=True):
    """A state of a stream that controls a held object: either `state`, or `measurement` in a stream with sensors.

    Args:
        desired: desired motion.
        state: state of hand and object.
        measurement: what the hand measured.
        external: estimated wrench on the object apart from gravity and finger forces, about O's origin, in O, N and N·m.
        conditions: slip, friction and lost drives of the contacts.
        contacts: change of the contacts to begin; states may repeat it.
    """

    desired: DesiredRecord
    state: StateRecord | None = None
    measurement: MeasurementRecord | None = None
    external: Vector6 | None = None
    conditions: ConditionsRecord | None = None
    contacts: ChangeRecord | None = None


class PhaseState(_StampedRecord, forbid_unknown_fields=True, kw_only=True):
    """A state of a stream of phases.

    Args:
        measurement: what the hand measured.
        stop: reason to stop the cycle with the safe stop of its phase.
    """

    measurement: MeasurementRecord
    stop: Annotated[str, Meta(max_length=200)] | None = None


class JointState(_StampedRecord, forbid_unknown_fields=True, kw_only=True):
    """A state of a stream of a law of motion.

    Args:
        measured: measured motion of the joints.
        desired: desired motion of the joints.
    """

    measured: JointMotionRecord
    desired: JointMotionRecord


class MeasuredTorqueRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """Measured joints of a force loop.

    Args:
        posture: positions, rad.
        velocity: rates, rad/s.
        torque: contact torques, N·m.
    """

    posture: Numbers
    velocity: Numbers
    torque: Numbers


class DesiredTorqueRecord(Struct, forbid_unknown_fields=True, kw_only=True):
    """Desired contact torques of a force loop.

    Args:
        torque: contact torques, N·m.
    """

    torque: Numbers


class ForceState(_StampedRecord, forbid_unknown_fields=True, kw_only=True):
    """A state of a stream of the force loop.

    Args:
        measured: measured joints.
        desired: desired contact torques.
    """

    measured: MeasuredTorqueRecord
    desired: DesiredTorqueRecord
