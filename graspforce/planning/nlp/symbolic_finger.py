"""Kinematics and inverse dynamics of a finger as CasADi expressions, built from the links of `Hand.tree`.

The recursive Newton–Euler algorithm in the links' own frames. Source: Featherstone (2008), table 5.1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.hand.kinematics.kinematic_tree import Link

_ROUNDING = 1e-15  # entries of a rotation below this are rounding errors of the URDF's angles


@dataclass(frozen=True, eq=False, slots=True)
class SymbolicFinger:
    """One finger of a hand, with all other fingers at rest.

    Attributes:
        joints: the m actuated joints that move it, by index; q, v and a below are theirs, in this order.
        torque: (q, v, a, gravity_H) → tau (m,), N·m: the rows of `Hand.inverse_dynamics` for these joints.
        tip: (q) → (3,) origin of the tip frame in H, m.
        jacobian: (q) → (6, m) Jacobian of the tip at its origin, in H's axes.
        bias: (q, v) → (6,) J̇ v, the tip's acceleration without joint acceleration, m/s² and rad/s².
    """

    joints: tuple[int, ...]
    torque: ca.Function
    tip: ca.Function
    jacobian: ca.Function
    bias: ca.Function


def symbolic_finger(hand: Hand, finger: str, posture: npt.ArrayLike) -> SymbolicFinger:
    """Return a finger as CasADi functions.

    Args:
        hand: the hand.
        finger: name of the finger.
        posture: (n,) posture of the joints that do not move this finger, rad.

    Raises:
        UnknownName: the hand has no such finger.
    """
    chosen = list(hand.finger(finger).joints)
    tree = hand.tree()
    q, v, a = (ca.SX.sym(name, len(chosen)) for name in "qva")
    g = ca.SX.sym("g", 3)

    at_rest = np.array(posture, dtype=np.float64)
    at_rest[chosen] = 0.0
    T = _sparse(hand.T[:, chosen])
    q_full = T @ q + ca.DM(hand.T @ at_rest + hand.q0)
    is_moved = _moved_links(tree.links, np.abs(hand.T[:, chosen]).sum(axis=1) > 0.0)

    poses = [_pose_on_parent(link, q_full[i]) for i, link in enumerate(tree.links)]
    tau_full = _inverse_dynamics(tree.links, poses, is_moved, (T @ v, T @ a, g))
    tau = T.T @ tau_full + ca.DM(hand.rotor_inertia[chosen]) * a

    tip = next(tip for tip in tree.tips if tip.finger == finger)
    p, axes = ca.SX(ca.DM(tip.p_LF)), [ca.SX.zeros(3)] * len(tree.links)
    link = tip.link
    while link >= 0:  # from the tip inward: express the tip and the joint axes in the frame of each link's parent
        if not tree.links[link].is_prismatic:
            axes[link] = ca.SX(_sparse(tree.links[link].axis))
        p_PL, R_PL = poses[link]
        p = p_PL + R_PL @ p
        axes = [R_PL @ axis for axis in axes]
        link = tree.links[link].parent
    J = ca.vertcat(ca.jacobian(p, q), ca.horzcat(*axes) @ T)
    bias = ca.jtimes(J @ v, q, v)
    return SymbolicFinger(
        joints=tuple(chosen),
        torque=ca.Function("torque", [q, v, a, g], [tau]),
        tip=ca.Function("tip", [q], [p]),
        jacobian=ca.Function("jacobian", [q], [J]),
        bias=ca.Function("bias", [q, v], [bias]),
    )


@lru_cache(maxsize=256)
def symbolic_link(hand: Hand, finger: str, link: int) -> ca.Function:
    """Return the pose in H of a link of a finger: (q) → p_HL (3,), m, and R_HL (3, 3); other joints are at rest at neutral.

    Args:
        hand: the hand.
        finger: name of the finger, whose joints are q.
        link: index of the link.
    """
    chosen, tree = list(hand.finger(finger).joints), hand.tree()
    q, at_rest = ca.SX.sym("q", len(chosen)), np.array(hand.neutral)
    at_rest[chosen] = 0.0
    q_full = _sparse(hand.T[:, chosen]) @ q + ca.DM(hand.T @ at_rest + hand.q0)
    p, R, at = ca.SX.zeros(3), ca.SX.eye(3), link
    while at >= 0:
        p_PL, R_PL = _pose_on_parent(tree.links[at], q_full[at])
        p, R, at = p_PL + R_PL @ p, R_PL @ R, tree.links[at].parent
    return ca.Function("link_pose", [q], [p, R])


def _moved_links(links: Sequence[Link], has_moving_joint: Array) -> list[bool]:
    """Return which links move: those with a moving joint, and their descendants."""
    moved: list[bool] = []
    for link, own in zip(links, has_moving_joint, strict=True):
        moved.append(bool(own) or (link.parent >= 0 and moved[link.parent]))
    return moved


def _sparse(matrix: Array) -> ca.DM:
    """Return a matrix without entries that are only rounding errors, which keeps expressions small."""
    return ca.sparsify(ca.DM(np.where(np.abs(matrix) < _ROUNDING, 0.0, matrix)))


def _pose_on_parent(link: Link, x: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return p_PL and R_PL of a link on its parent at joint position x."""
    p, R, axis = ca.SX(ca.DM(link.p_PL)), ca.SX(_sparse(link.R_PL)), _sparse(link.axis)
    if link.is_prismatic:
        return p + R @ axis * x, R
    K = ca.skew(axis)
    return p, R @ (ca.DM.eye(3) + ca.sin(x) * K + (1.0 - ca.cos(x)) * (K @ K))  # Rodrigues' formula


def _inverse_dynamics(
    links: Sequence[Link],
    poses: Sequence[tuple[ca.SX, ca.SX]],
    is_moved: Sequence[bool],
    motion: tuple[ca.SX, ca.SX, ca.SX],
) -> ca.SX:
    """Return the torques of all joints in the full coordinates, zero for links at rest.

    Args:
        links: the hand's links, parents first.
        poses: p_PL and R_PL of each link.
        is_moved: whether each link moves.
        motion: v and a of all joints in the full coordinates, and gravity_H.
    """
    v, a, g = motion
    rates: list[tuple[ca.SX, ca.SX, ca.SX]] = []  # of each link in its axes: ω, ω̇, acceleration of its origin minus gravity
    loads: list[tuple[ca.SX, ca.SX]] = []  # force and moment about its origin that move each link, in its axes
    for i, link in enumerate(links):
        p, R = poses[i]
        w_P, dw_P, a_P = (ca.DM.zeros(3), ca.DM.zeros(3), -g) if link.parent < 0 else rates[link.parent]
        axis = _sparse(link.axis)
        w, dw = R.T @ w_P, R.T @ dw_P
        origin = R.T @ (a_P + ca.cross(dw_P, p) + ca.cross(w_P, ca.cross(w_P, p)))  # m/s²
        if link.is_prismatic:
            origin += axis * a[i] + 2.0 * ca.cross(w, axis * v[i])
        else:
            dw += axis * a[i] + ca.cross(w, axis * v[i])
            w += axis * v[i]
        rates.append((w, dw, origin))
        c, inertia = ca.DM(link.p_LM), ca.DM(link.inertia)
        force = link.mass * (origin + ca.cross(dw, c) + ca.cross(w, ca.cross(w, c)))  # N
        loads.append((force, inertia @ dw + ca.cross(w, inertia @ w) + ca.cross(c, force)))

    tau = [ca.SX(0)] * len(links)
    for i in reversed(range(len(links))):
        if not is_moved[i]:
            continue
        link, (force, moment) = links[i], loads[i]
        tau[i] = ca.dot(_sparse(link.axis), force if link.is_prismatic else moment)
        if link.parent >= 0:
            p, R = poses[i]
            force_P = R @ force
            total, total_moment = loads[link.parent]
            loads[link.parent] = (total + force_P, total_moment + R @ moment + ca.cross(p, force_P))
    return ca.vertcat(*tau)
