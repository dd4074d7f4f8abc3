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
from graspforce.contact import ContactSet
from graspforce.hands.motion import TipMotion
from graspforce.shapes import Shape

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
        slide: (N, 2) how fast the fingertips slide over the object, along t₁ and t₂, m/s.
        gap: (N,) how far the fingertips are off the surface, m; negative where they press into it.
        touched: where the fingertips stand on the object.
    """

    p_OC: Array
    R_OC: Array
    J: Array
    A: Array
    B: Array
    beta: Array
    slide: Array
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
    count, n = len(contacts), tips.J.shape[2]
    R_HO, V, omega = motion.R_HO, motion.twist[:3], motion.twist[3:]
    spin = skew(omega[None])[0]  # 1/s: spin @ y = ω_O × y
    arm_c = tips.p_HF - motion.p_HO  # m, in H
    c_O = arm_c @ R_HO  # m, in O
    c_rel = tips.twist[:, :3] - V - arm_c @ spin.T  # m/s, in H

    p_OC, R_OC, over, gap = _touching(c_O, c_rel @ R_HO, radii, shape, contacts, R_before)
    R_CO = R_OC.transpose(0, 2, 1)
    R_CH = R_CO @ R_HO.T

    arm_x = p_OC @ R_HO.T  # x − p, m, in H
    lever = arm_x - arm_c  # x − c, m, in H
    x_less_p = arm_x @ spin.T + over @ R_HO.T  # ẋ − ṗ, m/s
    moving = np.empty((count, 6, n + 2))  # J, twist and drift of the tips, to be taken to the contacts together
    moving[:, :, :n], moving[:, :, n], moving[:, :, n + 1] = tips.J, tips.twist, tips.drift
    at_contact = R_CH @ (moving[:, :3] - skew(lever) @ moving[:, 3:])
    turning = np.matmul(skew(x_less_p + V - tips.twist[:, :3]), tips.twist[:, 3:, None])[:, :, 0]  # (ẋ − ċ) × ω_F, m/s²
    beta = (R_CH @ (x_less_p @ spin.T + turning)[:, :, None])[:, :, 0] - at_contact[:, :, n + 1]

    B = np.empty((count, 3, 6))
    B[:, :, :3], B[:, :, 3:] = R_CO, -R_CO @ skew(p_OC)  # e·(α × x) = (x × e)·α
    V_O = np.concatenate([V @ R_HO, omega @ R_HO])
    slide = at_contact[:, :2, n] - B[:, :2] @ V_O

    A = at_contact[:, :, :n]
    padded = np.empty((count, 4, n))
    padded[:, :3], padded[:, 3] = A, (R_CH[:, 2:3] @ tips.J[:, 3:])[:, 0]
    J = padded.reshape(-1, n)[contacts.columns]
    touched = Touched(c_O, R_HO.T @ tips.R_HF, p_OC)
    return RollingContacts(p_OC, R_OC, J, A.reshape(-1, n), B.reshape(-1, 6), beta.reshape(-1), slide, gap, touched)


def slid(before: Touched, now: Touched, R_OC: Array) -> Array:
    """(N, 2) how far fingertips slid over the object between two instants, along t₁ and t₂ of R_OC, m.

    The point of the finger that touched then has gone away from the point of the object that it touched. Rolling moves the two
    apart along the normal alone, to second order in the step; and errors of single positions do not add up over many steps.
    """
    lever = (before.p_OC - before.p_OF)[:, :, None]
    moved = now.R_OF @ (before.R_OF.transpose(0, 2, 1) @ lever) - lever
    apart = now.p_OF - before.p_OF + moved[:, :, 0]  # m, in O
    return np.asarray((apart[:, None, :] @ R_OC[:, :, :2])[:, 0])


def _touching(
    c: Array, c_rate: Array, radii: Array, shape: Shape | None, contacts: ContactSet, R_before: Array
) -> tuple[Array, Array, Array, Array]:
    """Points and frames, the points' velocity over the object, and gaps, for tips at c that move at c_rate, all in O."""
    round_tips = radii > 0.0
    if not round_tips.any():
        gap = -((c - contacts.p_OC) * contacts.R_OC[:, :, 2]).sum(axis=1)  # m
        return contacts.p_OC, contacts.R_OC, np.zeros(c.shape), gap
    before = R_before[:, :, 2]
    if shape is None:
        n = contacts.R_OC[:, :, 2]
        away = ((contacts.p_OC - c) * n).sum(axis=1)  # m
        x, over = c + away[:, None] * n, c_rate - (c_rate * n).sum(axis=1)[:, None] * n
    else:
        count, step = len(c), _AHEAD * c_rate  # m
        feet = shape.nearest(np.concatenate([c, c + step, c - step]))
        x, over = feet[:count], (feet[count : 2 * count] - feet[2 * count :]) / (2.0 * _AHEAD)
        inward = x - c
        away = np.sqrt((inward * inward).sum(axis=1))  # m
        away = np.where((inward * before).sum(axis=1) < 0.0, -away, away)  # a ball whose middle is inside
        n = np.where((np.abs(away) > 1e-9)[:, None], inward / np.where(away == 0.0, 1.0, away)[:, None], before)
    t1 = R_before[:, :, 0] - (R_before[:, :, 0] * n).sum(axis=1)[:, None] * n
    t1 = t1 / np.sqrt((t1 * t1).sum(axis=1))[:, None]
    R_OC = np.empty((len(c), 3, 3))
    R_OC[:, :, 0], R_OC[:, :, 1], R_OC[:, :, 2] = t1, (skew(n) @ t1[:, :, None])[:, :, 0], n
    gap = away - radii  # m
    if round_tips.all():
        return x, R_OC, over, gap
    fixed = ~round_tips
    x, over, gap = np.array(x), np.array(over), np.array(gap)
    x[fixed], R_OC[fixed], over[fixed] = contacts.p_OC[fixed], contacts.R_OC[fixed], 0.0
    gap[fixed] = -((c - contacts.p_OC) * contacts.R_OC[:, :, 2]).sum(axis=1)[fixed]
    return x, R_OC, over, gap


def skew(v: Array) -> Array:
    """(N, 3, 3) matrices S with S y = v × y, of N vectors (N, 3)."""
    S = np.zeros((len(v), 3, 3))
    S[:, 0, 1], S[:, 0, 2], S[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    S[:, 1, 0], S[:, 2, 0], S[:, 2, 1] = v[:, 2], -v[:, 1], v[:, 0]
    return S
