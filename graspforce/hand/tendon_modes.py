"""Hands with tendons: free differentials, the forces that they balance, and the hand after a joint of a tendon has stopped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields as record_fields
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactSet
from graspforce.core import arrays
from graspforce.core.arrays import freeze
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.hand.actuation import Actuation
from graspforce.hand.drives.drive import Drive, Drives
from graspforce.hand.drives.joint_friction import JointFriction
from graspforce.hand.drives.tendon import Tendon
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
from graspforce.hand.kinematics.coordinates import JointCoordinates, JointInfo


def balanced_actuation(
    hand: Hand,
    q: npt.ArrayLike,
    fingers: Sequence[str],
    contacts: ContactSet,
    p_HO: npt.ArrayLike,
    R_HO: npt.ArrayLike,
    gravity_H: npt.ArrayLike = GRAVITY_PALM_UP,
) -> Actuation:
    """Return the actuation of a hand at rest, with the balance of its differentials.

    The actuation of `Hand.actuation` gets one more entry for each differential, with limits of zero:

        (r_2 tau_1 − r_1 tau_2)/‖r‖ = 0,

    where tau_1 and tau_2 are the torques of its joints. The balance holds where both joints are free; a stopped joint needs
    none, because its stop bears the difference (see `stop_tendon_joints`). Source: Birglen, Laliberté and Gosselin (2008),
    chapter 2.

    Args:
        hand: the hand.
        q: (n,) joint positions, rad.
        fingers: name of the finger at each contact.
        contacts: the N contacts, in O.
        p_HO: (3,) position of the object in H, m.
        R_HO: (3, 3) axes of the object in H.
        gravity_H: (3,) acceleration of gravity in H, m/s².

    Returns:
        Actuation with n + d torques: those of the motors, and d differences, N·m.
    """
    plain = hand.actuation(q, fingers, contacts, p_HO, R_HO, gravity_H=gravity_H)
    differentials = [tendon for tendon in hand.tendons if tendon.kind == "differential"]
    if not differentials:
        return plain
    opposed = _with_opposed_motions(hand, differentials)
    q_both = np.concatenate([arrays.check_array(q, "q", (hand.n,)), np.zeros(len(differentials))])
    J = opposed.contact_jacobian(q_both, fingers, contacts, p_HO, R_HO)
    still = np.zeros(opposed.n)
    tau_u = opposed.inverse_dynamics(q_both, still, still, gravity_H)
    nothing = np.zeros(len(differentials))
    return Actuation(
        J,
        tau_u,
        np.concatenate([plain.lower, nothing]),
        np.concatenate([plain.upper, nothing]),
        np.concatenate([plain.weight, nothing]),
    )


def free_differentials(hand: Hand, fingers: Sequence[str]) -> Hand:
    """Return the hand whose differentials of some fingers are free: their joints move independently.

    Each gets one more joint without motor, whose position u turns the tendon's joints against each other:

        q_1 = q_a + u r_2/‖r‖,    q_2 = ρ q_a + q_0 − u r_1/‖r‖.

    Its torque is (r_2 tau_1 − r_1 tau_2)/‖r‖, and its limits are zero: forces are feasible only if the tendon balances them.
    `find_grasp` then finds grasps whose contact forces it balances. The limits of both positions are such that the tendon's
    joints stay inside theirs. Differentials of other fingers keep their coupling, since their joints rest at stops.

    Args:
        hand: the hand.
        fingers: names of the fingers that touch.

    Raises:
        UnknownName: the hand has no finger of that name.
    """
    touching = {joint for name in fingers for joint in hand.finger(name).joints}
    names = [joint.name for joint in hand.joints]
    free = [each for each in hand.tendons if each.kind == "differential" and names.index(each.joints[0]) in touching]
    return _with_opposed_motions(hand, free) if free else hand


def stop_tendon_joints(hand: Hand, positions: Mapping[str, float]) -> Hand:
    """Return the hand after joints of tendons have stopped: the other joint of each tendon now moves with the motor.

    Torque, rate, inertia and friction of the motor are converted to the moving joint, so that the motor's power is the same. A
    limit or a contact can only push: whether it bears the torque of the stopped joint is not checked.

    Args:
        hand: the hand.
        positions: position of each stopped joint by name, rad. A differential stops either joint, at its limit or at a contact;
            a breakaway stops the first one.

    Raises:
        UnknownName: no tendon has a joint of that name; lists the joints.
        InvalidInput: both joints of a tendon, the second joint of a breakaway, or a position outside the joint's limits.
    """
    limits = {link.joint: (link.lower, link.upper) for link in hand.tree().links}
    tendon_of = {name: tendon for tendon in hand.tendons for name in tendon.joints}
    coordinates = {field.name: getattr(hand, field.name) for field in record_fields(JointCoordinates)}
    result = JointCoordinates(**coordinates)
    for name, given in positions.items():
        if name not in tendon_of:
            raise UnknownName("joint", name, list(tendon_of))
        field, tendon = f"positions.{name}", tendon_of[name]
        position = arrays.check_number(given, field)
        if tendon not in result.tendons:
            raise InvalidInput("positions", list(positions), "one joint of each tendon")
        if not limits[name][0] <= position <= limits[name][1]:
            raise InvalidInput(field, position, f"within [{limits[name][0]:g}, {limits[name][1]:g}] rad")
        result = _stopped(result, tendon, tendon.joints.index(name), position, limits)
    return replace(hand, **vars(result), model=hand.model.in_coordinates(result))


def _stopped(
    before: JointCoordinates, tendon: Tendon, stopped: int, position: float, limits: Mapping[str, tuple[float, float]]
) -> JointCoordinates:
    """Return the coordinates after one joint of a tendon has stopped."""
    slope, moving = tendon.slope_after_stop(stopped), tendon.joints[1 - stopped]
    j = [joint.name for joint in before.joints].index(tendon.joints[0])
    rows = [before.full_joints.index(name) for name in (tendon.joints[stopped], moving)]
    T, q0 = np.array(before.T), np.array(before.q0)
    T[rows, j], q0[rows] = (0.0, 1.0), (position, 0.0)
    old = before.joints[j]
    joint = replace(
        old,
        name=moving,
        lower=limits[moving][0],
        upper=limits[moving][1],
        velocity=old.velocity * slope,
        torque=old.torque / slope,
        rotor_inertia=old.rotor_inertia / slope**2,
        holding_torque=None if old.holding_torque is None else old.holding_torque / slope,
    )
    scale = np.ones(before.n)
    scale[j] = slope
    neutral = np.array(before.neutral)
    neutral[j] = np.clip(neutral[j] * tendon.ratio if stopped == 0 else neutral[j], joint.lower, joint.upper)
    friction, each = before.friction, list(before.drives.joints)
    each[j] = _scaled_drive(each[j], slope)
    return replace(
        before,
        joints=(*before.joints[:j], joint, *before.joints[j + 1 :]),
        T=freeze(T),
        q0=freeze(q0),
        neutral=freeze(neutral),
        torque_weight=freeze(before.torque_weight * scale**2),
        friction=JointFriction(
            friction.coulomb / scale,
            friction.stribeck / scale,
            friction.stribeck_velocity * scale,
            friction.viscous / scale**2,
            friction.sources,
        ),
        drives=Drives(tuple(each)),
        tendons=tuple(other for other in before.tendons if other != tendon),
    )


def _scaled_drive(drive: Drive, slope: float) -> Drive:
    """Return a drive at a joint that turns `slope` times as far."""
    constant, stiffness = drive.torque_constant, drive.stiffness
    return replace(
        drive,
        torque_constant=None if constant is None else constant / slope,
        stiffness=None if stiffness is None else stiffness / slope**2,
        damping=drive.damping / slope**2,
        backlash=drive.backlash * slope,
        beyond_limits=drive.beyond_limits * slope,
    )


def _with_opposed_motions(hand: Hand, differentials: Sequence[Tendon]) -> Hand:
    """Return the hand with one more joint for each differential, which turns its joints against each other.

    By virtual work the torque of such a joint is the difference of the torques of the tendon's joints.
    """
    names, joints, extra = [joint.name for joint in hand.joints], list(hand.joints), []
    T = np.zeros((len(hand.full_joints), len(differentials)))
    fingers = list(hand.fingers)
    for k, tendon in enumerate(differentials):
        leader = names.index(tendon.joints[0])
        T[[hand.full_joints.index(name) for name in tendon.joints], k] = tendon.balance
        joints[leader], opposed = _shared_range(joints[leader], tendon)
        extra.append(opposed)
        for f, finger in enumerate(fingers):
            if leader in finger.joints:
                fingers[f] = replace(finger, joints=(*finger.joints, hand.n + k))
    nothing, friction = np.zeros(len(extra)), hand.friction
    numbers = {name: np.concatenate([getattr(friction, name), nothing]) for name in ("coulomb", "stribeck", "viscous")}
    rates = np.concatenate([friction.stribeck_velocity, np.ones(len(extra))])  # rad/s; any, since there is no friction
    sources = [*friction.sources, *([""] * len(extra))]
    neutral = np.clip(hand.neutral, [joint.lower for joint in joints], [joint.upper for joint in joints])
    coordinates: dict[str, Any] = {field.name: getattr(hand, field.name) for field in record_fields(JointCoordinates)}
    coordinates |= {
        "fingers": tuple(fingers),
        "joints": (*joints, *extra),
        "T": freeze(np.hstack([hand.T, T])),
        "neutral": freeze(np.concatenate([neutral, nothing])),
        "torque_weight": freeze(np.concatenate([hand.torque_weight, nothing])),
        "friction": JointFriction(**numbers, stribeck_velocity=rates, sources=sources),
        "drives": Drives((*hand.drives.joints, *([Drive()] * len(extra)))),
        "tendons": tuple(tendon for tendon in hand.tendons if tendon not in differentials),
    }
    return replace(hand, **coordinates, model=hand.model.in_coordinates(JointCoordinates(**coordinates)))


def _shared_range(leader: JointInfo, tendon: Tendon) -> tuple[JointInfo, JointInfo]:
    """Return the leader of a differential with a smaller range, and the joint that turns both joints against each other.

    A quarter of the leader's range, at each end, is left to the opposed motion.
    """
    quarter = 0.25 * (leader.upper - leader.lower)  # rad
    share = np.abs(tendon.balance) / [1.0, abs(tendon.ratio)]  # rad of the leader per rad of the opposed motion
    largest = quarter / float(share.max())  # rad
    opposed = replace(
        leader,
        name=f"{tendon.joints[0]}-{tendon.joints[1]}",
        lower=-largest,
        upper=largest,
        torque=0.0,
        rotor_inertia=0.0,
        holding_torque=None,
    )
    return replace(leader, lower=leader.lower + quarter, upper=leader.upper - quarter), opposed
