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

from graspforce import arrays
from graspforce.arrays import Array, frozen
from graspforce.body import BodyMotion
from graspforce.control import ControlSettings, Desired, GraspMotion, GraspState, ObjectLaw, body_of, fit
from graspforce.control.rolling import RollingContacts, rolling_contacts
from graspforce.control.ties import Ties
from graspforce.errors import InvalidInput
from graspforce.hands.coordinates import JointInfo
from graspforce.hold import Hold
from graspforce.planning import Plan, Refusal, Task, joint_reference, reference
from graspforce.planning.refusal import SINGULAR, UNHOLDABLE, UNREACHABLE, UNSOLVED

WINDOW = 0.005  # s: somewhat longer than what contacts take to follow a step in their force
RESERVE = 0.1  # of motor torques: what feedback, and contacts that are not rigid, take on top of a plan
_SPREAD = 0.01  # of A: singular values below this part of the largest are directions that a finger has lost
_ENDS = 0.01  # rad: what joints keep to the ends of their range
_ROOM, _HASTE = 0.02, 0.03  # rad, and of joint speeds: what plans leave of them to holding the posture and being softened
_SLOWEST = 1.6  # σ: a plan that needs more is not mended but wrong
_PACE = 0.05  # to which σ is found


@dataclass(frozen=True, eq=False, slots=True)
class Rehearsal:
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
class Paced:
    """A plan at the pace at which a controller can follow it.

    Attributes:
        plan: the plan.
        slowed, window: the move takes ``slowed`` times the plan's duration and ``window`` s.
        rehearsal: at that pace, without fault.
    """

    plan: Plan
    slowed: float
    window: float
    rehearsal: Rehearsal

    @property
    def duration(self) -> float:
        """Of the move, s."""
        return self.slowed * self.plan.duration + self.window

    def reference(self) -> Callable[[float], GraspMotion]:
        """What the controller is told, from time in s to the desired motion of object and joints."""
        return followed(self.plan, self.slowed, self.window)


def followed(plan: Plan, slowed: float = 1.0, window: float = WINDOW) -> Callable[[float], GraspMotion]:
    """A plan's motion over time, of object and joints; arguments as `planning.reference`."""
    body = reference(plan, slowed=slowed, window=window)
    joints = joint_reference(plan, slowed=slowed, window=window)
    return lambda t: GraspMotion(body(t), *joints(t))


def task(hold: Hold, settings: ControlSettings, reserve: float = RESERVE) -> Task:
    """The task of moving what is held, with what the controller keeps back kept back from the planner too.

    Args:
        hold: hand, object and contacts.
        settings: the controller's: its slip margin, its reserve of friction and its gravity are the planner's.
        reserve: the part of every motor's torque that is left to the controller, in [0, 1).
    """
    contacts = replace(hold.contacts, mu=frozen(hold.contacts.mu * (1.0 - settings.friction_reserve)))
    hand = hold.hand.derated(1.0 - kept_back(reserve))
    hand = replace(hand, joints=tuple(_narrowed(joint, float(q)) for joint, q in zip(hand.joints, hold.q, strict=True)))
    return Task(hand, hold.body, contacts, hold.fingers, settings.gravity_H, settings.slip_margin)


def kept_back(reserve: float) -> float:
    """A part of the motors' torque, checked to be in [0, 1)."""
    reserve = arrays.number(reserve, "reserve", minimum=0.0)
    if reserve >= 1.0:
        raise InvalidInput("reserve", reserve, "less than 1")
    return reserve


def _narrowed(joint: JointInfo, q: float) -> JointInfo:
    """A joint with less of its range and speed, its posture q in the hold still within."""
    lower, upper = min(joint.lower + _ROOM, q), max(joint.upper - _ROOM, q)
    return replace(joint, lower=lower, upper=upper, velocity=(1.0 - _HASTE) * joint.velocity)


def rehearse(plan: Plan, hold: Hold, settings: ControlSettings, slowed: float = 1.0, window: float = WINDOW) -> Rehearsal:
    """Go through a plan with contacts that roll, and ask the controller's law for its forces, to the end or the first fault.

    Args:
        plan: begins where the hold is.
        hold: what the controller holds.
        settings: the controller's.
        slowed, window: as `planning.reference`.
    """
    follow = followed(plan, slowed, window)
    return rehearse_motion(follow, slowed * plan.duration + window, hold, settings)


def rehearse_motion(follow: Callable[[float], Desired], duration: float, hold: Hold, settings: ControlSettings) -> Rehearsal:
    """Go through any motion of the object as `rehearse` does: what cannot go on, and when, is known before anything moves.

    Soft contacts tie the fingers' spin; a motion that a finger can follow only by spinning on the object is at fault there.

    Args:
        follow: from time in s to the desired motion; it begins where the hold is.
        duration: s.
        hold: what the controller holds.
        settings: the controller's.

    Raises:
        InvalidInput: a motion of the joints of another hand.
    """
    hand, law, ties = hold.hand, ObjectLaw(hold, settings), Ties.made_by(hold.contacts)
    dt, braking = settings.period, settings.posture_braking or 1.0  # 1/s; where it is zero nothing pulls
    radii = np.array([hand.finger(name).tip_radius or 0.0 for name in hold.fingers])  # m
    used = sorted({joint for name in hold.fingers for joint in hand.finger(name).joints})
    memory, R_OC = law.start(), hold.contacts.R_OC
    q, v, before = np.array(hold.q), np.zeros(hand.n), None
    rows: list[tuple[float, Array, Array, Array, Array]] = []
    fault, kind, joint = "", "", None
    for k in range(int(np.ceil(duration / dt)) + 1):
        t = k * dt
        desired = follow(t)
        body = body_of(desired)
        fit(hand, q, desired)
        rolling = rolling_contacts(hand.tip_motion(q, v, hold.fingers), radii, body, hold.body.shape, hold.contacts, R_OC)
        v_d, _, pull = law.joints_wanted(q, desired)
        v, lost = _rates(ties, rolling, body, v_d + pull / braking)
        if lost is not None:
            how = "can go on only by spinning on it" if ties.is_spin(lost) else "is stretched out or folded, and cannot go on"
            fault, kind = f"{hold.fingers[ties.contact[lost]]} {how}", SINGULAR
            break
        off = np.minimum(q - hand.q_lower, hand.q_upper - q)[used]
        if off.min() < _ENDS:
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
        if command.held or command.slip_margin[hold.contacts.mu > 0.0].min(initial=np.inf) < wanted:
            fault, kind = "no forces keep the wanted slip margin with the motors' torques", UNHOLDABLE
            break
        rows.append((t, q, v, command.tau, command.slip_margin))
        R_OC = rolling.R_OC
        q = q + dt * (v if before is None else 1.5 * v - 0.5 * before)  # second order: Adams and Bashforth
        before = v
    times, q_s, v_s, tau, margin = (frozen(np.array([row[i] for row in rows])) for i in range(5))
    return Rehearsal(times, q_s, v_s, tau, margin, fault, kind, t, joint)


def paced(plan: Plan, hold: Hold, settings: ControlSettings, window: float = WINDOW) -> Paced | Refusal:
    """The plan at the quickest pace at which its rehearsal finds no fault, or the reason why no pace is slow enough.

    Args: as `rehearse`.
    """
    least, most = 1.0, _SLOWEST
    found = rehearse(plan, hold, settings, least, window)
    if not found.fault:
        return Paced(plan, least, window, found)
    slow = found if found.kind in (SINGULAR, UNREACHABLE) else rehearse(plan, hold, settings, most, window)
    if slow.fault:
        share = min(slow.at / ((least if slow is found else most) * plan.duration), 1.0)
        reason = f"With contacts that roll, after {100.0 * share:.0f} % of the move {slow.fault}."
        return Refusal(slow.kind, reason, None, slow.joint)
    best = Paced(plan, most, window, slow)
    while most - least > _PACE:
        sigma = (least + most) / 2.0
        tried = rehearse(plan, hold, settings, sigma, window)
        if tried.fault:
            least = sigma
        else:
            most, best = sigma, Paced(plan, sigma, window, tried)
    return best


def _rates(ties: Ties, rolling: RollingContacts, motion: BodyMotion, posture: Array) -> tuple[Array, int | None]:
    """(n,) joint rates with which contacts roll, rad/s; and which row of A is blocked, where one is."""
    twist = (motion.twist.reshape(2, 3) @ motion.R_HO).ravel()
    A, B, _ = ties.of(rolling)
    wanted = B @ twist - A @ posture  # m/s
    U, sigma, Vt = np.linalg.svd(A, full_matrices=False)
    kept = sigma > _SPREAD * sigma[0]
    rates = posture + Vt[kept].T @ ((U[:, kept].T @ wanted) / sigma[kept])
    missed = np.abs(A @ rates - B @ twist)
    blocked = missed.max() > 1e-6 * max(float(np.abs(wanted).max()), 1e-3)
    return rates, int(missed.argmax()) if blocked else None
