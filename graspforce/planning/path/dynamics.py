"""The dynamics of a move along a given path: everything is linear in b = ṡ², a = s̈ and the contact forces f.

    G f = w₀ + w_b b + w_a a                              the object
    tau = tau₀ + tau_b b + tau_a a + Jᵀ f                 the motors
    b ≤ cap                                               joint speeds, (v_max/q')²

Verscheure et al., Time-optimal path tracking for robots: a convex optimization approach (2009), with the object's dynamics and
contact forces as in 001 (3)–(16). Contacts that roll are elsewhere at every knot, and so are G and J; where they are depends on
s alone, so nothing else changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import grasp_matrices
from graspforce.core.arrays import Array
from graspforce.planning.path.paths import ContactPoints, JointPoints, PosePoints
from graspforce.planning.task import Task


@dataclass(frozen=True, eq=False, slots=True)
class PathDynamics:
    """The equations above at K knots; arrays over joints have no columns without a hand, over forces none without an object.

    Args:
        s: (K,) the knots.
        contacts: what they can bear; None without an object.
        G: (K, 6, k).
        w_0, w_b, w_a: (K, 6) N and N·m, per unit of 1, b and a.
        J: (K, k, n) m/rad.
        tau_0, tau_b, tau_a: (K, n) N·m, likewise.
        lower, upper: (n,) the motors' limits, N·m.
        cap: (K,) the largest b, 1/s²; inf for none.
        b_max_between: (K − 1,) likewise in the middle between knots.
    """

    s: Array
    contacts: ContactSet | None
    G: Array
    w_0: Array
    w_b: Array
    w_a: Array
    J: Array
    tau_0: Array
    tau_b: Array
    tau_a: Array
    lower: Array
    upper: Array
    b_max: Array
    b_max_between: Array

    def torque(self, b: Array, a: Array, f: Array) -> Array:
        """(K, n) the motor torques of b (K,), a (K,) and f (K, k), N·m."""
        bare = self.tau_0 + self.tau_b * b[:, None] + self.tau_a * a[:, None]
        return np.asarray(bare + np.einsum("ikn,ik->in", self.J, f))


def path_dynamics(
    task: Task,
    s: Array,
    poses: PosePoints | None,
    joints: JointPoints | None,
    joints_between: JointPoints | None,
    contacts: ContactPoints | None = None,
) -> PathDynamics:
    """The equations along a path.

    Args:
        task: what moves.
        s: (K,) the knots.
        poses: the object's path at the knots; None without an object.
        joints: the joints' path at the knots; None without a hand.
        joints_between: the joints' path in the middle between knots.
        contacts: where the contacts are at the knots; None without an object.
    """
    K, n, k = len(s), task.joints, task.force_size
    w_0 = w_b = w_a = np.zeros((K, 6))
    G, J = np.zeros((K, 6, k)), np.zeros((K, k, n))
    if poses is not None and contacts is not None and task.contacts is not None and task.body is not None:
        zero, R_OH = np.zeros((K, 3)), poses.R.transpose(0, 2, 1)
        w_0 = task.body.wrenches(-(R_OH @ task.gravity_H), zero, zero)
        w_a = task.body.wrenches((R_OH @ poses.p_s[:, :, None])[:, :, 0], zero, poses.omega)
        w_b = task.body.wrenches((R_OH @ poses.p_ss[:, :, None])[:, :, 0], poses.omega, poses.omega_s)
        G, J = grasp_matrices(task.contacts, contacts.p_OC, contacts.R_OC), contacts.J
    tau_0 = tau_b = tau_a = np.zeros((K, n))
    lower, upper = np.zeros(n), np.zeros(n)
    b_max, b_max_between = np.full(K, np.inf), np.full(K - 1, np.inf)
    if joints is not None and task.hand is not None:
        hand, rest, free = task.hand, np.zeros((K, n)), np.zeros(3)
        tau_0 = hand.inverse_dynamics_along(joints.q, rest, rest, task.gravity_H)
        tau_a = hand.inverse_dynamics_along(joints.q, rest, joints.q_s, free)
        tau_b = hand.inverse_dynamics_along(joints.q, joints.q_s, joints.q_ss, free)
        lower, upper = hand.torque_lower, hand.torque_upper
        b_max = _b_max(hand.velocity_limit, joints.q_s)
        if joints_between is not None:
            b_max_between = _b_max(hand.velocity_limit, joints_between.q_s)
    return PathDynamics(s, task.contacts, G, w_0, w_b, w_a, J, tau_0, tau_b, tau_a, lower, upper, b_max, b_max_between)


def _b_max(velocity_limit: Array, q_s: Array) -> Array:
    """(K,) the largest b that every joint's speed limit allows: |q' ṡ| ≤ v_max."""
    share = (np.abs(q_s) / velocity_limit).max(axis=1)  # s
    return np.asarray(np.divide(1.0, share**2, out=np.full(len(share), np.inf), where=share > 0))
