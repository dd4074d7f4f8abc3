"""A hand's kinematics and inverse dynamics as CasADi expressions, built from the links that Pinocchio reads.

Newton's and Euler's laws outward and inward along the links (Featherstone, Rigid Body Dynamics Algorithms, 2008, table 5.1),
in the links' own frames, with linear accelerations of the links' origins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.hand.kinematic_tree import Link

_ROUNDING = 1e-15  # an entry of a rotation below this is a zero that a URDF's angles could not say


@dataclass(frozen=True, eq=False, slots=True)
class SymbolicFinger:
    """One finger of a hand, all others at rest.

    Attributes:
        joints: indices of the m actuated joints that move it; q, v, a below are theirs, in this order.
        torque: (q, v, a, gravity_H) → tau (m,): `Hand.inverse_dynamics` of these joints.
        tip: (q) → (3,) where its tip frame stands in H, m.
        jacobian: (q) → (6, m) the tip's velocity and angular velocity per joint rate, in H's axes.
        bias: (q, v) → (6,) J̇ v, the tip's acceleration and angular acceleration without joint acceleration, m/s², rad/s².
    """

    joints: tuple[int, ...]
    torque: ca.Function
    tip: ca.Function
    jacobian: ca.Function
    bias: ca.Function


def symbolic_finger(hand: Hand, finger: str, posture: Any) -> SymbolicFinger:
    """A finger as CasADi functions.

    Args:
        hand: the hand.
        finger: its name.
        posture: (n,) where the joints stand that do not move this finger, rad.

    Raises:
        UnknownName: a finger that the hand does not have.
    """
    chosen = list(hand.finger(finger).joints)
    tree = hand.tree()
    q, v, a = (ca.SX.sym(name, len(chosen)) for name in "qva")
    g = ca.SX.sym("g", 3)

    at_rest = np.array(posture, dtype=np.float64)
    at_rest[chosen] = 0.0
    T = _exact(hand.T[:, chosen])
    q_full = T @ q + ca.DM(hand.T @ at_rest + hand.q0)
    moved = _is_moved(tree.links, np.abs(hand.T[:, chosen]).sum(axis=1) > 0.0)

    places = [_place(link, q_full[i]) for i, link in enumerate(tree.links)]  # on their parents
    tau_full = _inverse_dynamics(tree.links, places, moved, T @ v, T @ a, g)
    tau = T.T @ tau_full + ca.DM(hand.rotor_inertia[chosen]) * a

    tip = next(tip for tip in tree.tips if tip.finger == finger)
    p, turns = ca.SX(ca.DM(tip.p_LF)), [ca.SX.zeros(3)] * len(tree.links)
    link = tip.link
    while link >= 0:  # inward: the tip, and the axes of the joints that carry it, from each link's frame to its parent's
        if not tree.links[link].is_prismatic:
            turns[link] = ca.SX(_exact(tree.links[link].axis))
        p_PL, R_PL = places[link]
        p = p_PL + R_PL @ p
        turns = [R_PL @ axis for axis in turns]
        link = tree.links[link].parent
    J = ca.vertcat(ca.jacobian(p, q), ca.horzcat(*turns) @ T)
    bias = ca.jtimes(J @ v, q, v)
    return SymbolicFinger(
        joints=tuple(chosen),
        torque=ca.Function("torque", [q, v, a, g], [tau]),
        tip=ca.Function("tip", [q], [p]),
        jacobian=ca.Function("jacobian", [q], [J]),
        bias=ca.Function("bias", [q, v], [bias]),
    )


def _is_moved(links: Sequence[Link], by_itself: Array) -> list[bool]:
    """Which links move when the chosen joints do: their own, and all that those carry."""
    moved: list[bool] = []
    for link, own in zip(links, by_itself, strict=True):
        moved.append(bool(own) or (link.parent >= 0 and moved[link.parent]))
    return moved


def _exact(matrix: Array) -> ca.DM:
    """A sparse constant without rounding's dust, so that expressions stay small."""
    return ca.sparsify(ca.DM(np.where(np.abs(matrix) < _ROUNDING, 0.0, matrix)))


def _place(link: Link, x: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Where a link stands on its parent: p_PL and R_PL at joint position x."""
    p, R, axis = ca.SX(ca.DM(link.p_PL)), ca.SX(_exact(link.R_PL)), _exact(link.axis)
    if link.is_prismatic:
        return p + R @ axis * x, R
    K = ca.skew(axis)
    return p, R @ (ca.DM.eye(3) + ca.sin(x) * K + (1.0 - ca.cos(x)) * (K @ K))  # Rodrigues


def _inverse_dynamics(
    links: Sequence[Link], places: Sequence[tuple[ca.SX, ca.SX]], moved: Sequence[bool], v: ca.SX, a: ca.SX, g: ca.SX
) -> ca.SX:
    """The torques of all joints in the full coordinates; zero for links that do not move, whose weight the base bears."""
    motion: list[tuple[ca.SX, ca.SX, ca.SX]] = []  # of each link, in its axes: ω, ω̇, and the acceleration of its origin less g
    loads: list[tuple[ca.SX, ca.SX]] = []  # force and moment about its origin that move each link, in its axes
    for i, link in enumerate(links):
        p, R = places[i]
        w_P, dw_P, a_P = (ca.DM.zeros(3), ca.DM.zeros(3), -g) if link.parent < 0 else motion[link.parent]
        axis = _exact(link.axis)
        w, dw = R.T @ w_P, R.T @ dw_P
        origin = R.T @ (a_P + ca.cross(dw_P, p) + ca.cross(w_P, ca.cross(w_P, p)))  # m/s²
        if link.is_prismatic:
            origin += axis * a[i] + 2.0 * ca.cross(w, axis * v[i])
        else:
            dw += axis * a[i] + ca.cross(w, axis * v[i])
            w += axis * v[i]
        motion.append((w, dw, origin))
        c, inertia = ca.DM(link.p_LM), ca.DM(link.inertia)
        force = link.mass * (origin + ca.cross(dw, c) + ca.cross(w, ca.cross(w, c)))  # N
        loads.append((force, inertia @ dw + ca.cross(w, inertia @ w) + ca.cross(c, force)))

    tau = [ca.SX(0)] * len(links)
    for i in reversed(range(len(links))):
        if not moved[i]:
            continue
        link, (force, moment) = links[i], loads[i]
        tau[i] = ca.dot(_exact(link.axis), force if link.is_prismatic else moment)
        if link.parent >= 0:
            p, R = places[i]
            carried = R @ force
            below = loads[link.parent]
            loads[link.parent] = (below[0] + carried, below[1] + R @ moment + ca.cross(p, carried))
    return ca.vertcat(*tau)
