"""Contacts that roll: where round fingertips touch the object now, how contacts move, and what keeps them from slipping.

A ball of radius r about a fingertip's origin c touches the object at the point x of its surface that is nearest to c; the
inward normal n there points from c to x. Finger and object have the same velocity at x,

    ċ + ω_F × (x − c) = ṗ + ω_O × (x − p),

p the object's origin, and stay so when the time derivatives agree too, x moving as the contact does, ẋ = ṗ + ω_O × (x − p) + u:

    c̈ + ω̇_F × (x − c) + ω_F × (ẋ − ċ) = p̈ + ω̇_O × (x − p) + ω_O × (ẋ − ṗ).

u is the contact's velocity over the object, by Montana's first equation (The Kinematics of Contact and Grasp, 1988):
u = (1 + r S)⁻¹ ċ_rel across n, S the surface's shape operator and ċ_rel the velocity of c as the object sees it. (1 + r S)⁻¹ is
the derivative of the nearest point, so u is taken as the rate of the nearest point itself: one law for every shape, edges
included.

A tip without a radius touches with its origin, always at the same place of the object.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.arrays import Array
from graspforce.body import BodyMotion
from graspforce.contact import ContactModel, ContactSet
from graspforce.hands.motion import TipMotion
from graspforce.shapes import Shape

_TINY = 1e-9  # m: a middle nearer to the surface than this gives no normal
_AHEAD = 1e-4  # s: the nearest point's rate is a central difference over ± this, 10 µm at 0.1 m/s; its error is of second order


@dataclass(frozen=True, eq=False, slots=True)
class Touched:
    """Where N fingertips stood on the object at one instant, for the next to see how far they slid.

    Attributes:
        p_OF, R_OF: (N, 3) in m and (N, 3, 3): their tip frames in O.
        p_OC: (N, 3) where they touched, in O, m.
    """

    p_OF: Array
    R_OF: Array
    p_OC: Array


@dataclass(frozen=True, eq=False, slots=True)
class RollingContacts:
    """N contacts at one instant.

    Attributes:
        p_OC: (N, 3) where they are, in O, m.
        R_OC: (N, 3, 3) their frames in O, t₁ turned no more about n than the normals' turning asks.
        J: (k, n) the contact Jacobian: tau = Jᵀ f.
        A: (3 N, n) joint rates to the velocities of the fingers' points at the contacts, in the contact frames, m/rad.
        B: (3 N, 6) the object's twist, in O's axes, to the velocities of its points there: the transpose of point contacts' G.
        beta: (3 N,) what the points' accelerations lack: A q̈ = B a + beta keeps the contacts, m/s²; a in O's axes.
        velocity: (N, 3) of the fingers' points at the contacts, in the contact frames, m/s.
        gap: (N,) how far the fingertips are off the surface, m; negative where they press into it.
        touched: where the fingertips stand on the object.
    """

    p_OC: Array
    R_OC: Array
    J: Array
    A: Array
    B: Array
    beta: Array
    velocity: Array
    gap: Array
    touched: Touched


def rolling_contacts(
    tips: TipMotion, radii: Array, motion: BodyMotion, shape: Shape | None, contacts: ContactSet, R_before: Array
) -> RollingContacts:
    """The contacts of fingertips that touch an object.

    Args:
        tips: the fingertips, in the contacts' order.
        radii: (N,) of their balls, m; zero for a tip that touches with its origin.
        motion: the object's pose and twist.
        shape: its surface; None where nobody knows it: flat about each contact.
        contacts: where the hold began, in O, and what the contacts can bear.
        R_before: (N, 3, 3) the contact frames at the last step, in O, which the tangents follow.
    """
    count, n = len(radii), tips.J.shape[2]
    R_HO, V, twist = motion.R_HO, motion.twist[:3], tips.twist
    spin_T = skew(motion.twist[3:])[0].T  # 1/s: y @ spin_T = ω_O × y
    arm_c = tips.p_HF - motion.p_HO  # m, in H
    c_O = arm_c @ R_HO  # m, in O
    c_rate = twist[:, :3] - V  # m/s, in H

    p_OC, R_OC, over, gap = _touching(c_O, (c_rate - arm_c @ spin_T) @ R_HO, radii, shape, contacts, R_before)
    R_CO = R_OC.transpose(0, 2, 1)
    R_CH = R_CO @ R_HO.T

    arm_x = p_OC @ R_HO.T  # x − p, m, in H
    x_rate = arm_x @ spin_T + over @ R_HO.T  # ẋ − ṗ, m/s
    across = skew(np.concatenate([arm_x - arm_c, x_rate - c_rate, p_OC]))  # by x − c, ẋ − ċ, and by x in O

    moving = np.empty((count, 6, n + 2))  # J, twist and drift of the tips, to be taken to the contacts together
    moving[:, :, :n], moving[:, :, n], moving[:, :, n + 1] = tips.J, twist, tips.drift
    at_contact = moving[:, :3] - across[:count] @ moving[:, 3:]
    at_contact[:, :, n + 1] -= x_rate @ spin_T + (across[count : 2 * count] @ twist[:, 3:, None])[:, :, 0]  # m/s²
    at_contact = R_CH @ at_contact
    B = np.empty((count, 3, 6))
    B[:, :, :3], B[:, :, 3:] = R_CO, -R_CO @ across[2 * count :]  # e·(α × x) = (x × e)·α

    J = A = at_contact[:, :, :n].reshape(-1, n)
    if any(model is not ContactModel.POINT for model in contacts.models):
        padded = np.empty((count, 4, n))
        padded[:, :3], padded[:, 3] = at_contact[:, :, :n], (R_CH[:, 2:3] @ tips.J[:, 3:])[:, 0]
        J = padded.reshape(-1, n)[contacts.columns]
    touched = Touched(c_O, R_HO.T @ tips.R_HF, p_OC)
    beta = -at_contact[:, :, n + 1].ravel()
    return RollingContacts(p_OC, R_OC, J, A, B.reshape(-1, 6), beta, at_contact[:, :, n], gap, touched)


def sliding(rolling: RollingContacts, motion: BodyMotion) -> Array:
    """(N, 2) how fast fingertips slide over the object, along t₁ and t₂, m/s."""
    twist_O = (motion.twist.reshape(2, 3) @ motion.R_HO).ravel()
    return np.asarray((rolling.velocity - (rolling.B @ twist_O).reshape(-1, 3))[:, :2])


def slid(before: Touched, now: Touched, R_OC: Array) -> Array:
    """(N, 2) how far fingertips slid over the object between two instants, along t₁ and t₂ of R_OC, m.

    The point of the finger that touched then has gone away from the point of the object that it touched. Rolling moves the two
    apart along the normal alone, to second order in the step; and errors of single positions do not add up over many steps.
    """
    lever = (before.p_OC - before.p_OF)[:, :, None]
    apart = now.p_OF - before.p_OC + (now.R_OF @ (before.R_OF.transpose(0, 2, 1) @ lever))[:, :, 0]  # m, in O
    return np.asarray((apart[:, None, :] @ R_OC[:, :, :2])[:, 0])


def _touching(
    c: Array, c_rate: Array, radii: Array, shape: Shape | None, contacts: ContactSet, R_before: Array
) -> tuple[Array, Array, Array, Array]:
    """Points and frames, the points' velocity over the object, and gaps, for tips at c that move at c_rate, all in O."""
    bare = [radius == 0.0 for radius in radii.tolist()]
    if all(bare):
        return contacts.p_OC, contacts.R_OC, np.zeros(c.shape), _below(contacts, c)
    before, count = R_before[:, :, 2], len(c)
    if shape is None:
        n = contacts.R_OC[:, :, 2]
        away = _dot(contacts.p_OC - c, n)  # m
        x, over = c + away * n, c_rate - _dot(c_rate, n) * n
    else:
        step = _AHEAD * c_rate  # m
        feet = shape.nearest(np.concatenate([c, c + step, c - step]))
        x, over = feet[:count], (feet[count : 2 * count] - feet[2 * count :]) * (0.5 / _AHEAD)
        inward = x - c
        away = np.copysign(np.sqrt(_dot(inward, inward)), _dot(inward, before))  # m; negative: the ball's middle is inside
        there = np.abs(away) > _TINY
        n = inward / away if there.all() else np.where(there, inward / np.where(there, away, 1.0), before)
    t1 = R_before[:, :, 0]
    t1 = t1 - _dot(t1, n) * n
    t1 = t1 / np.sqrt(_dot(t1, t1))
    R_OC = np.empty((count, 3, 3))
    R_OC[:, :, 0], R_OC[:, :, 1], R_OC[:, :, 2] = t1, (skew(n) @ t1[:, :, None])[:, :, 0], n
    gap = away[:, 0] - radii  # m
    if any(bare):
        x, over = np.array(x), np.array(over)
        x[bare], R_OC[bare], over[bare] = contacts.p_OC[bare], contacts.R_OC[bare], 0.0
        gap[bare] = _below(contacts, c)[bare]
    return x, R_OC, over, gap


def _below(contacts: ContactSet, c: Array) -> Array:
    """(N,) how far points are off the contacts where a hold began, against their normals, m."""
    return np.asarray(_dot(contacts.p_OC - c, contacts.R_OC[:, :, 2])[:, 0])


def _dot(a: Array, b: Array) -> Array:
    """(N, 1) inner products of (N, 3) vectors."""
    return np.asarray((a * b) @ _ONES)


def skew(v: Array) -> Array:
    """(N, 3, 3) matrices S with S y = v × y, of vectors (N, 3) or (3,)."""
    return np.asarray((v @ _CROSS).reshape(-1, 3, 3))


_ONES = np.ones((3, 1))
_CROSS = np.array([[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], dtype=np.float64)
