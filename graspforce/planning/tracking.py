"""Tracking of plans by the controller: the task that leaves it a reserve, a check of tracking, and time scaling.

A plan's contacts roll, but the plan contains neither the controller nor its smoothed reference. Before a plan is executed, its
tracking is therefore checked kinematically: the object follows the reference exactly, and the joints roll with the controller's
pull towards the plan's posture,

    A q̇ = B (ṗ, ω),   q̇ = A⁺ B (ṗ, ω) + (1 − A⁺ A) (q̇_plan + k (q_plan − q)),   k = k_p / max(k_d, 2 √k_p)

The control law then gives the forces of every period. If a motor, a joint speed or friction does not suffice, the plan is
time-scaled: poses stay, rates fall by 1/σ and accelerations by 1/σ².
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from graspforce.contact.compiled_kinematics import rolling_contacts
from graspforce.contact.kinematics import RollingContacts
from graspforce.contact.motion import BodyMotion
from graspforce.control import (
    ControlSettings,
    DesiredMotion,
    GraspMotion,
    GraspState,
    ObjectControlLaw,
    check_joint_count,
    object_motion,
)
from graspforce.control.command import Command
from graspforce.control.contacts.contact_constraints import ContactConstraints
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.hand.kinematics.coordinates import JointInfo
from graspforce.planning.failure import SINGULAR, UNHOLDABLE, UNREACHABLE, UNSOLVED, PlanFailure
from graspforce.planning.plan import Plan
from graspforce.planning.reference import joint_reference, object_reference
from graspforce.planning.task import GraspTask

SMOOTHING_WINDOW = 0.005  # s: longer than contacts need to follow a step in force
TORQUE_RESERVE = 0.1  # of motor torques: left to feedback and to contacts that are not rigid
_RANK_TOLERANCE = 0.01  # relative singular value of A below which a direction of a finger is lost
_BLOCKED_TOLERANCE = 1e-6  # of the tips' speed: larger violations of A q̇ = B (ṗ, ω) are not rounding errors
_MIN_SPEED = 1e-3  # m/s: slower motions are judged like this one
_SOLVER_TOLERANCE = 1e-6  # of the largest force: error of a slip margin
_RANGE_MARGIN = 0.01  # rad: margin that joints keep from the ends of their range
_PLAN_RANGE_MARGIN = 0.02  # rad: margin that plans leave, for the posture's feedback and the smoothing
_PLAN_SPEED_MARGIN = 0.03  # likewise of joint speeds, relative
_MAX_TIME_SCALE = 1.6  # σ: plans that need more are given up
_TIME_SCALE_TOLERANCE = 0.05  # of σ


@dataclass(frozen=True, eq=False, slots=True)
class TrackingCheck:
    """A motion tracked kinematically with rolling contacts, up to its first fault.

    Attributes:
        t: (M,) times, s.
        q: (M, n) joint positions, rad.
        v: (M, n) joint velocities, rad/s.
        tau: (M, n) motor torques, N·m.
        slip_margin: (M, N) slip margins, N.
        fault: the first fault in words; "" if there is none.
        fault_kind: its kind, one of `planning.failure.KINDS`; "" if there is none.
        fault_time: its time, s; the end if there is none.
        joint: name of the joint that causes it, if there is one.
    """

    t: Array
    q: Array
    v: Array
    tau: Array
    slip_margin: Array
    fault: str
    fault_kind: str
    fault_time: float
    joint: str | None


@dataclass(frozen=True, eq=False, slots=True)
class TimeScaledPlan:
    """A plan at a pace at which the controller can track it.

    Attributes:
        plan: the plan.
        time_scale: σ: the move takes σ times the plan's duration and ``window`` s.
        window: time over which the reference is averaged, s.
        tracking_check: the check at that pace, without fault.
    """

    plan: Plan
    time_scale: float
    window: float
    tracking_check: TrackingCheck

    @property
    def duration(self) -> float:
        """Return the duration of the move, s."""
        return self.time_scale * self.plan.duration + self.window

    def reference(self) -> Callable[[float], GraspMotion]:
        """Return the controller's reference: the motion of object and joints as a function of time in s."""
        return grasp_reference(self.plan, self.time_scale, self.window)


def grasp_reference(plan: Plan, time_scale: float = 1.0, window: float = SMOOTHING_WINDOW) -> Callable[[float], GraspMotion]:
    """Return a plan's motion of object and joints as a function of time in s.

    Args:
        plan: plan of a hand with an object.
        time_scale: σ > 0; the plan takes σ times as long.
        window: time over which the motion is averaged, s, ≥ 0; the move takes that much longer.
    """
    body = object_reference(plan, time_scale=time_scale, window=window)
    joints = joint_reference(plan, time_scale=time_scale, window=window)
    return lambda t: GraspMotion(body(t), *joints(t))


def object_task(grasp: Grasp, settings: ControlSettings, torque_reserve: float = TORQUE_RESERVE) -> GraspTask:
    """Return the task of moving a grasped object, with the controller's reserves of friction, torque, speed and range.

    Args:
        grasp: the grasp at the start.
        settings: the controller's settings; their slip margin, friction reserve and gravity apply to the plan.
        torque_reserve: share of every motor's torque that is left to the controller, in [0, 1).

    Raises:
        InvalidInput: torque_reserve out of range.
    """
    contacts = replace(grasp.contacts, mu=freeze(grasp.contacts.mu * (1.0 - settings.friction_reserve)))
    hand = grasp.hand.derated(1.0 - check_torque_reserve(torque_reserve))
    hand = replace(hand, joints=tuple(_tighten_joint(joint, float(q)) for joint, q in zip(hand.joints, grasp.q, strict=True)))
    return GraspTask(hand, grasp.body, contacts, grasp.fingers, settings.gravity_H, settings.slip_margin)


def check_torque_reserve(torque_reserve: float, field: str = "torque_reserve") -> float:
    """Return a share of motor torque in [0, 1).

    Args:
        torque_reserve: the share.
        field: its path for error messages.

    Raises:
        InvalidInput: out of range.
    """
    torque_reserve = arrays.check_number(torque_reserve, field, minimum=0.0)
    if torque_reserve >= 1.0:
        raise InvalidInput(field, torque_reserve, "less than 1")
    return torque_reserve


def check_tracking(
    plan: Plan, grasp: Grasp, settings: ControlSettings, time_scale: float = 1.0, window: float = SMOOTHING_WINDOW
) -> TrackingCheck:
    """Check the tracking of a plan with rolling contacts and the controller's forces, up to the end or the first fault.

    Args:
        plan: a plan that begins at the grasp.
        grasp: the grasp at the start.
        settings: the controller's settings.
        time_scale: σ > 0; the plan takes σ times as long.
        window: time over which the motion is averaged, s, ≥ 0; the move takes that much longer.
    """
    follow = grasp_reference(plan, time_scale, window)
    return check_motion_tracking(follow, time_scale * plan.duration + window, grasp, settings)


def check_motion_tracking(
    follow: Callable[[float], DesiredMotion], duration: float, grasp: Grasp, settings: ControlSettings
) -> TrackingCheck:
    """Check the tracking of any motion of the object, as `check_tracking` does for plans, before anything moves.

    A soft contact prevents spin. A motion that a finger can only follow by spinning on the object is a fault.

    Args:
        follow: the desired motion as a function of time in s; it begins at the grasp.
        duration: of the motion, s.
        grasp: the grasp at the start.
        settings: the controller's settings.

    Raises:
        InvalidInput: a motion with the joints of another hand.
    """
    tracker = _Tracker(grasp, settings)
    rows: list[tuple[float, Array, Array, Array, Array]] = []
    fault = _NO_FAULT
    for k in range(int(np.ceil(duration / settings.period)) + 1):
        t = k * settings.period
        command, fault = tracker.step(follow(t))
        if command is None:
            break
        rows.append((t, tracker.q, tracker.v, command.tau, command.slip_margin))
        tracker.advance()
    times, q, v, tau, margin = (freeze(np.array([row[i] for row in rows])) for i in range(5))
    return TrackingCheck(times, q, v, tau, margin, fault.words, fault.kind, t, fault.joint)


def time_scale_plan(
    plan: Plan, grasp: Grasp, settings: ControlSettings, window: float = SMOOTHING_WINDOW
) -> TimeScaledPlan | PlanFailure:
    """Return the plan at the fastest pace without a fault in its tracking, or the reason why there is no such pace.

    Args:
        plan: a plan that begins at the grasp.
        grasp: the grasp at the start.
        settings: the controller's settings.
        window: time over which the motion is averaged, s, ≥ 0; the move takes that much longer.
    """
    lower, upper = 1.0, _MAX_TIME_SCALE
    at_pace = check_tracking(plan, grasp, settings, lower, window)
    if not at_pace.fault:
        return TimeScaledPlan(plan, lower, window, at_pace)
    if at_pace.fault_kind in (SINGULAR, UNREACHABLE):  # independent of the pace
        return _tracking_failure(at_pace, lower * plan.duration)
    slowest = check_tracking(plan, grasp, settings, upper, window)
    if slowest.fault:
        return _tracking_failure(slowest, upper * plan.duration)
    best = TimeScaledPlan(plan, upper, window, slowest)
    while upper - lower > _TIME_SCALE_TOLERANCE:
        sigma = (lower + upper) / 2.0
        check = check_tracking(plan, grasp, settings, sigma, window)
        if check.fault:
            lower = sigma
        else:
            upper, best = sigma, TimeScaledPlan(plan, sigma, window, check)
    return best


@dataclass(frozen=True, slots=True)
class _Fault:
    """A fault of tracking: its words, its kind, and the joint that causes it."""

    words: str
    kind: str
    joint: str | None = None


_NO_FAULT = _Fault("", "")


class _Tracker:
    """The joints, stepped with rolling contacts while the object follows the desired motion exactly.

    Args:
        grasp: the grasp at the start.
        settings: the controller's settings.
    """

    def __init__(self, grasp: Grasp, settings: ControlSettings) -> None:
        hand = grasp.hand
        self._grasp, self._settings, self._law = grasp, settings, ObjectControlLaw(grasp, settings)
        self._constraints = ContactConstraints.from_contacts(grasp.contacts)
        self._decay_rate = settings.posture_decay_rate or 1.0  # 1/s; without stiffness the pull is zero, whatever the rate
        self._radii = np.array([hand.finger(name).tip_radius or 0.0 for name in grasp.fingers])  # m
        self._joints = sorted({joint for name in grasp.fingers for joint in hand.finger(name).joints})
        self._memory, self._R_OC = self._law.initial_memory(), grasp.contacts.R_OC
        self._last_v: Array | None = None
        self.q, self.v = np.array(grasp.q), np.zeros(hand.n)

    def step(self, desired: DesiredMotion) -> tuple[Command | None, _Fault]:
        """Return the controller's command for the desired motion, or None with the fault."""
        grasp, body = self._grasp, object_motion(desired)
        check_joint_count(grasp.hand, self.q, desired)
        tips = grasp.hand.tip_motion(self.q, self.v, grasp.fingers)
        rolling = rolling_contacts(tips, self._radii, body, grasp.body.shape, grasp.contacts, self._R_OC)
        v_d, _, pull = self._law.compute_joint_targets(self.q, desired)
        self.v, blocked = _rolling_rates(self._constraints, rolling, body, v_d + pull / self._decay_rate)
        fault = self._joint_fault() if blocked is None else self._blocked_fault(blocked)
        if fault is not _NO_FAULT:
            return None, fault
        command, self._memory = self._law.step(self._memory, GraspState(self.q, self.v, body), desired)
        fault = self._force_fault(command)
        self._R_OC = rolling.R_OC
        return (command if fault is _NO_FAULT else None), fault

    def advance(self) -> None:
        """Integrate the joints over one period, by the second-order Adams–Bashforth method."""
        rate = self.v if self._last_v is None else 1.5 * self.v - 0.5 * self._last_v
        self.q, self._last_v = self.q + self._settings.period * rate, self.v

    def _blocked_fault(self, row: int) -> _Fault:
        """Return the fault of a finger that cannot roll along."""
        finger = self._grasp.fingers[self._constraints.contact_index[row]]
        if self._constraints.is_spin_row(row):
            return _Fault(f"{finger} cannot follow without spinning on the object", SINGULAR)
        return _Fault(f"{finger} is singular, stretched out or folded, and cannot follow", SINGULAR)

    def _joint_fault(self) -> _Fault:
        """Return the fault of a joint that leaves its range or exceeds its speed limit."""
        hand, joints = self._grasp.hand, self._joints
        distance = np.minimum(self.q - hand.q_lower, hand.q_upper - self.q)[joints]
        if distance.min() < _RANGE_MARGIN:
            joint = hand.joints[joints[int(distance.argmin())]].name
            return _Fault(f"{joint} reaches the end of its range", UNREACHABLE, joint)
        share = np.abs(self.v)[joints] / hand.velocity_limit[joints]
        if share.max() > 1.0:
            joint = hand.joints[joints[int(share.argmax())]].name
            return _Fault(f"{joint} exceeds its speed limit, at {100.0 * share.max():.0f} % of it", UNSOLVED, joint)
        return _NO_FAULT

    def _force_fault(self, command: Command) -> _Fault:
        """Return the fault of a command without new forces or with too small a slip margin."""
        required = self._settings.slip_margin - _SOLVER_TOLERANCE * np.abs(command.f).max()
        rough = self._grasp.contacts.mu > 0.0
        if command.forces_reused or command.slip_margin[rough].min(initial=np.inf) < required:
            return _Fault("no contact forces within the motors' torques give the required slip margin", UNHOLDABLE)
        return _NO_FAULT


def _tighten_joint(joint: JointInfo, q: float) -> JointInfo:
    """Return a joint with less range and speed; its position q in the grasp stays inside."""
    lower, upper = min(joint.lower + _PLAN_RANGE_MARGIN, q), max(joint.upper - _PLAN_RANGE_MARGIN, q)
    return replace(joint, lower=lower, upper=upper, velocity=(1.0 - _PLAN_SPEED_MARGIN) * joint.velocity)


def _tracking_failure(check: TrackingCheck, duration: float) -> PlanFailure:
    """Return the failure of a plan that cannot be tracked; ``duration`` of the plan at the pace of the check, s."""
    share = min(check.fault_time / duration, 1.0)
    reason = f"With rolling contacts, after {100.0 * share:.0f} % of the move {check.fault}."
    return PlanFailure(check.fault_kind, reason, None, check.joint)


def _rolling_rates(
    constraints: ContactConstraints, rolling: RollingContacts, motion: BodyMotion, posture_rates: Array
) -> tuple[Array, int | None]:
    """Return joint rates (n,) with which the contacts roll, rad/s, and the row of A that is blocked, if one is."""
    twist = (motion.twist.reshape(2, 3) @ motion.R_HO).ravel()
    A, B, _ = constraints.constraint_rows(rolling)
    error = B @ twist - A @ posture_rates  # m/s
    U, sigma, Vt = np.linalg.svd(A, full_matrices=False)
    kept = sigma > _RANK_TOLERANCE * sigma[0]
    rates = posture_rates + Vt[kept].T @ ((U[:, kept].T @ error) / sigma[kept])
    violation = np.abs(A @ rates - B @ twist)
    blocked = violation.max() > _BLOCKED_TOLERANCE * max(float(np.abs(error).max()), _MIN_SPEED)
    return rates, int(violation.argmax()) if blocked else None
