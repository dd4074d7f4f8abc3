"""A plan as something that a controller follows: what it leaves for the controller, its pace, and its pose at every instant.

Plans have their contacts roll, but know neither the controller nor that it is told a softened motion. So a plan is rehearsed
before anybody follows it: the object exactly where it should be, the joints where rolling and the controller's wish for the
plan's posture take them,

    A q̇ = B (ṗ, ω),   q̇ = A⁺ B (ṗ, ω) + (1 − A⁺ A) (q̇_plan + k (q_plan − q)),   k = k_p / max(k_d, 2 √k_p),

and the controller's own law asked for the forces, every period. Where a motor, a joint's speed or friction would not do, the
plan is followed more slowly: poses stay, rates fall with 1/σ and accelerations with 1/σ².
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
from graspforce.control.contact_constraints import ContactConstraints
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.hand.coordinates import JointInfo
from graspforce.planning import Plan, PlanFailure, Task, joint_reference, object_reference
from graspforce.planning.failure import SINGULAR, UNHOLDABLE, UNREACHABLE, UNSOLVED

SMOOTHING_WINDOW = 0.005  # s: somewhat longer than what contacts take to follow a step in their force
TORQUE_RESERVE = 0.1  # of motor torques: what feedback, and contacts that are not rigid, take on top of a plan
_RANK_TOLERANCE = 0.01  # of A: singular values below this part of the largest are directions that a finger has lost
_RANGE_MARGIN = 0.01  # rad: what joints keep to the ends of their range
_PLAN_RANGE_MARGIN, _PLAN_SPEED_MARGIN = (
    0.02,
    0.03,
)  # rad, and of joint speeds: what plans leave of them to holding the posture and being softened
_MAX_TIME_SCALE = 1.6  # σ: a plan that needs more is not mended but wrong
_TIME_SCALE_TOLERANCE = 0.05  # to which σ is found


@dataclass(frozen=True, eq=False, slots=True)
class TrackingCheck:
    """A plan gone through with contacts that roll, up to its first fault.

    Attributes:
        t: (M,) s.
        q, v: (M, n) rad and rad/s.
        tau: (M, n) N·m.
        slip_margin: (M, N) what friction is left, N.
        fault: the first thing that is amiss, in words; "" for none.
        kind: the fault's, one of `planning.refusal`'s words; "" for none.
        at: when, s.
        joint: which joint is to blame, by name, or None.
    """

    t: Array
    q: Array
    v: Array
    tau: Array
    slip_margin: Array
    fault: str
    kind: str
    at: float
    joint: str | None


@dataclass(frozen=True, eq=False, slots=True)
class TimeScaledPlan:
    """A plan at the pace at which a controller can follow it.

    Attributes:
        plan: the plan.
        time_scale, window: the move takes ``time_scale`` times the plan's duration and ``window`` s.
        rehearsal: at that pace, without fault.
    """

    plan: Plan
    time_scale: float
    window: float
    tracking_check: TrackingCheck

    @property
    def duration(self) -> float:
        """Of the move, s."""
        return self.time_scale * self.plan.duration + self.window

    def reference(self) -> Callable[[float], GraspMotion]:
        """What the controller is told, from time in s to the desired motion of object and joints."""
        return grasp_reference(self.plan, self.time_scale, self.window)


def grasp_reference(plan: Plan, time_scale: float = 1.0, window: float = SMOOTHING_WINDOW) -> Callable[[float], GraspMotion]:
    """A plan's motion over time, of object and joints; arguments as `planning.reference`."""
    body = object_reference(plan, time_scale=time_scale, window=window)
    joints = joint_reference(plan, time_scale=time_scale, window=window)
    return lambda t: GraspMotion(body(t), *joints(t))


def object_task(grasp: Grasp, settings: ControlSettings, torque_reserve: float = TORQUE_RESERVE) -> Task:
    """The task of moving what is held, with what the controller keeps back kept back from the planner too.

    Args:
        hold: hand, object and contacts.
        settings: the controller's: its slip margin, its reserve of friction and its gravity are the planner's.
        reserve: the part of every motor's torque that is left to the controller, in [0, 1).
    """
    contacts = replace(grasp.contacts, mu=freeze(grasp.contacts.mu * (1.0 - settings.friction_reserve)))
    hand = grasp.hand.derated(1.0 - check_torque_reserve(torque_reserve))
    hand = replace(hand, joints=tuple(_tighten_joint(joint, float(q)) for joint, q in zip(hand.joints, grasp.q, strict=True)))
    return Task(hand, grasp.body, contacts, grasp.fingers, settings.gravity_H, settings.slip_margin)


def check_torque_reserve(torque_reserve: float) -> float:
    """A part of the motors' torque, checked to be in [0, 1)."""
    torque_reserve = arrays.check_number(torque_reserve, "reserve", minimum=0.0)
    if torque_reserve >= 1.0:
        raise InvalidInput("reserve", torque_reserve, "less than 1")
    return torque_reserve


def _tighten_joint(joint: JointInfo, q: float) -> JointInfo:
    """A joint with less of its range and speed, its posture q in the hold still within."""
    lower, upper = min(joint.lower + _PLAN_RANGE_MARGIN, q), max(joint.upper - _PLAN_RANGE_MARGIN, q)
    return replace(joint, lower=lower, upper=upper, velocity=(1.0 - _PLAN_SPEED_MARGIN) * joint.velocity)


def check_tracking(
    plan: Plan, grasp: Grasp, settings: ControlSettings, time_scale: float = 1.0, window: float = SMOOTHING_WINDOW
) -> TrackingCheck:
    """Go through a plan with contacts that roll, and ask the controller's law for its forces, to the end or the first fault.

    Args:
        plan: begins where the hold is.
        hold: what the controller holds.
        settings: the controller's.
        time_scale, window: as `planning.reference`.
    """
    follow = grasp_reference(plan, time_scale, window)
    return check_motion_tracking(follow, time_scale * plan.duration + window, grasp, settings)


def check_motion_tracking(
    follow: Callable[[float], DesiredMotion], duration: float, grasp: Grasp, settings: ControlSettings
) -> TrackingCheck:
    """Go through any motion of the object as `check_tracking` does: what cannot go on, and when, is known before anything
    moves.

    Soft contacts tie the fingers' spin; a motion that a finger can follow only by spinning on the object is at fault there.

    Args:
        follow: from time in s to the desired motion; it begins where the hold is.
        duration: s.
        hold: what the controller holds.
        settings: the controller's.

    Raises:
        InvalidInput: a motion of the joints of another hand.
    """
    hand, law, constraints = grasp.hand, ObjectControlLaw(grasp, settings), ContactConstraints.from_contacts(grasp.contacts)
    dt, braking = settings.period, settings.posture_decay_rate or 1.0  # 1/s; where it is zero nothing pulls
    radii = np.array([hand.finger(name).tip_radius or 0.0 for name in grasp.fingers])  # m
    used = sorted({joint for name in grasp.fingers for joint in hand.finger(name).joints})
    memory, R_OC = law.initial_memory(), grasp.contacts.R_OC
    q, v, before = np.array(grasp.q), np.zeros(hand.n), None
    rows: list[tuple[float, Array, Array, Array, Array]] = []
    fault, kind, joint = "", "", None
    for k in range(int(np.ceil(duration / dt)) + 1):
        t = k * dt
        desired = follow(t)
        body = object_motion(desired)
        check_joint_count(hand, q, desired)
        rolling = rolling_contacts(hand.tip_motion(q, v, grasp.fingers), radii, body, grasp.body.shape, grasp.contacts, R_OC)
        v_d, _, pull = law.compute_joint_targets(q, desired)
        v, lost = _rolling_rates(constraints, rolling, body, v_d + pull / braking)
        if lost is not None:
            how = (
                "can go on only by spinning on it"
                if constraints.is_spin_row(lost)
                else "is stretched out or folded, and cannot go on"
            )
            fault, kind = f"{grasp.fingers[constraints.contact_index[lost]]} {how}", SINGULAR
            break
        off = np.minimum(q - hand.q_lower, hand.q_upper - q)[used]
        if off.min() < _RANGE_MARGIN:
            joint = hand.joints[used[int(off.argmin())]].name
            fault, kind = f"{joint} comes to the end of its range", UNREACHABLE
            break
        fast = np.abs(v)[used] / hand.velocity_limit[used]
        if fast.max() > 1.0:
            joint = hand.joints[used[int(fast.argmax())]].name
            fault, kind = f"{joint} would have to turn at {100.0 * fast.max():.0f} % of its speed limit", UNSOLVED
            break
        command, memory = law.step(memory, GraspState(q, v, body), desired)
        wanted = settings.slip_margin - 1e-6 * np.abs(command.f).max()  # the solver's tolerance
        if command.forces_reused or command.slip_margin[grasp.contacts.mu > 0.0].min(initial=np.inf) < wanted:
            fault, kind = "no forces keep the wanted slip margin with the motors' torques", UNHOLDABLE
            break
        rows.append((t, q, v, command.tau, command.slip_margin))
        R_OC = rolling.R_OC
        q = q + dt * (v if before is None else 1.5 * v - 0.5 * before)  # second order: Adams and Bashforth
        before = v
    times, q_s, v_s, tau, margin = (freeze(np.array([row[i] for row in rows])) for i in range(5))
    return TrackingCheck(times, q_s, v_s, tau, margin, fault, kind, t, joint)


def time_scale_plan(
    plan: Plan, grasp: Grasp, settings: ControlSettings, window: float = SMOOTHING_WINDOW
) -> TimeScaledPlan | PlanFailure:
    """The plan at the quickest pace at which its rehearsal finds no fault, or the reason why no pace is slow enough.

    Args: as `check_tracking`.
    """
    least, most = 1.0, _MAX_TIME_SCALE
    found = check_tracking(plan, grasp, settings, least, window)
    if not found.fault:
        return TimeScaledPlan(plan, least, window, found)
    slow = found if found.kind in (SINGULAR, UNREACHABLE) else check_tracking(plan, grasp, settings, most, window)
    if slow.fault:
        share = min(slow.at / ((least if slow is found else most) * plan.duration), 1.0)
        reason = f"With contacts that roll, after {100.0 * share:.0f} % of the move {slow.fault}."
        return PlanFailure(slow.kind, reason, None, slow.joint)
    best = TimeScaledPlan(plan, most, window, slow)
    while most - least > _TIME_SCALE_TOLERANCE:
        sigma = (least + most) / 2.0
        tried = check_tracking(plan, grasp, settings, sigma, window)
        if tried.fault:
            least = sigma
        else:
            most, best = sigma, TimeScaledPlan(plan, sigma, window, tried)
    return best


def _rolling_rates(
    constraints: ContactConstraints, rolling: RollingContacts, motion: BodyMotion, posture: Array
) -> tuple[Array, int | None]:
    """(n,) joint rates with which contacts roll, rad/s; and which row of A is blocked, where one is."""
    twist = (motion.twist.reshape(2, 3) @ motion.R_HO).ravel()
    A, B, _ = constraints.constraint_rows(rolling)
    wanted = B @ twist - A @ posture  # m/s
    U, sigma, Vt = np.linalg.svd(A, full_matrices=False)
    kept = sigma > _RANK_TOLERANCE * sigma[0]
    rates = posture + Vt[kept].T @ ((U[:, kept].T @ wanted) / sigma[kept])
    missed = np.abs(A @ rates - B @ twist)
    blocked = missed.max() > 1e-6 * max(float(np.abs(wanted).max()), 1e-3)
    return rates, int(missed.argmax()) if blocked else None
