"""Equations of motion along a path: linear in b = ṡ², a = s̈ and the contact forces f.

    G f = w₀ + w_b b + w_a a                              the object
    tau = tau₀ + tau_b b + tau_a a + Jᵀ f                 the motors
    b ≤ b_max                                             joint speeds, b_max = (v_max/q')²
    ‖p' a + p'' b‖ ≤ linear,  ‖Ω a + Ω' b‖ ≤ angular      accelerations of the object
    |q' a + q'' b| ≤ joints                               accelerations of the joints

G and J differ from knot to knot where contacts roll, but depend on s only. Sources: Verscheure et al. (2009) for the form;
Al-Gallaf (undated) for the object's dynamics with contact forces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import grasp_matrices
from graspforce.core.arrays import Array
from graspforce.planning.path.knots import PathKnots
from graspforce.planning.task import HandTask, ObjectTask, Task


@dataclass(frozen=True, eq=False, slots=True)
class PathAccelerations:
    """Accelerations at K knots as shares of their limits, linear in b and a. Only what has a limit is contained.

    Args:
        object_b: (K, c, 2) accelerations of the object per unit of b, in the plane of both terms, s².
        object_a: (K, c, 2) the same per unit of a, s².
        joints_b: (K, m) accelerations of the joints per unit of b, s².
        joints_a: (K, m) the same per unit of a, s².
    """

    object_b: Array
    object_a: Array
    joints_b: Array
    joints_a: Array

    @classmethod
    def of_path(cls, task: Task, knots: PathKnots) -> PathAccelerations:
        """Return the accelerations along a path.

        Args:
            task: the task with its limits.
            knots: the path at its knots.
        """
        limits, K = task.acceleration_limits, len(knots.s)
        planes = []
        if isinstance(task, ObjectTask):
            at = knots.poses
            vectors = (np.stack([at.p_s, at.p_ss], axis=2), np.stack([at.omega, at.omega_s], axis=2))
            # x = [x_a, x_b] = Q U with orthonormal columns of Q: ‖x (a, b)‖ = ‖U (a, b)‖
            planes = [np.linalg.qr(x / most)[1] for x, most in zip(vectors, limits.object_limits, strict=True) if most < np.inf]
        plane = np.stack(planes, axis=1) if planes else np.zeros((K, 0, 2, 2))
        joints_a = joints_b = np.zeros((K, 0))
        if isinstance(task, HandTask) and limits.joints < np.inf:
            joints_a, joints_b = knots.joints.q_s / limits.joints, knots.joints.q_ss / limits.joints
        return cls(plane[:, :, :, 1], plane[:, :, :, 0], joints_b, joints_a)


@dataclass(frozen=True, eq=False, slots=True)
class PathDynamics:
    """Equations of motion at K knots. Arrays over joints have no columns without a hand, over forces none without an object.

    Args:
        s: (K,) path parameters.
        contacts: the contacts; None without an object.
        G: (K, 6, k) grasp matrices.
        w_0: (K, 6) wrench at rest, N and N·m.
        w_b: (K, 6) wrench per unit of b.
        w_a: (K, 6) wrench per unit of a.
        J: (K, k, n) contact Jacobians, m/rad.
        tau_0: (K, n) torques at rest without contact, N·m.
        tau_b: (K, n) torques per unit of b.
        tau_a: (K, n) torques per unit of a.
        lower: (n,) lower torque limits, N·m.
        upper: (n,) upper torque limits, N·m.
        b_max: (K,) largest b, 1/s²; inf for no limit.
        b_max_between: (K − 1,) largest b halfway between knots, 1/s².
        accelerations: those that have limits; None for no limits.
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
    accelerations: PathAccelerations | None = None

    def torque(self, b: Array, a: Array, f: Array) -> Array:
        """Return the motor torques (K, n), N·m.

        Args:
            b: (K,) ṡ², 1/s².
            a: (K,) s̈, 1/s².
            f: (K, k) stacked contact forces, N and N·m.
        """
        without_contact = self.tau_0 + self.tau_b * b[:, None] + self.tau_a * a[:, None]
        return np.asarray(without_contact + np.einsum("ikn,ik->in", self.J, f))


def path_dynamics(task: Task, knots: PathKnots) -> PathDynamics:
    """Return the equations of motion along a path.

    Args:
        task: the task.
        knots: the path at its knots.
    """
    K, n, k = len(knots.s), task.joint_count, task.force_size
    contacts: ContactSet | None = None
    w_0 = w_b = w_a = np.zeros((K, 6))
    G, J = np.zeros((K, 6, k)), np.zeros((K, k, n))
    if isinstance(task, ObjectTask):
        poses, zero = knots.poses, np.zeros((K, 3))
        R_OH = poses.R.transpose(0, 2, 1)
        w_0 = task.body.wrenches(-(R_OH @ task.gravity_H), zero, zero)
        w_a = task.body.wrenches((R_OH @ poses.p_s[:, :, None])[:, :, 0], zero, poses.omega)
        w_b = task.body.wrenches((R_OH @ poses.p_ss[:, :, None])[:, :, 0], poses.omega, poses.omega_s)
        contacts, J = task.contacts, knots.contacts.J
        G = grasp_matrices(contacts, knots.contacts.p_OC, knots.contacts.R_OC)
    tau_0 = tau_b = tau_a = np.zeros((K, n))
    lower, upper = np.zeros(n), np.zeros(n)
    b_max, b_max_between = np.full(K, np.inf), np.full(K - 1, np.inf)
    if isinstance(task, HandTask):
        hand, joints, rest, no_gravity = task.hand, knots.joints, np.zeros((K, n)), np.zeros(3)
        tau_0 = hand.inverse_dynamics_along(joints.q, rest, rest, task.gravity_H)
        tau_a = hand.inverse_dynamics_along(joints.q, rest, joints.q_s, no_gravity)
        tau_b = hand.inverse_dynamics_along(joints.q, joints.q_s, joints.q_ss, no_gravity)
        lower, upper = hand.torque_lower, hand.torque_upper
        b_max, b_max_between = (_b_max(hand.velocity_limit, at.q_s) for at in (joints, knots.midpoints))
    accelerations = PathAccelerations.of_path(task, knots)
    torques = (tau_0, tau_b, tau_a, lower, upper)
    return PathDynamics(knots.s, contacts, G, w_0, w_b, w_a, J, *torques, b_max, b_max_between, accelerations)


def _b_max(velocity_limit: Array, q_s: Array) -> Array:
    """Return the largest b (K,) within every joint's speed limit, |q' ṡ| ≤ v_max, 1/s²."""
    share = (np.abs(q_s) / velocity_limit).max(axis=1)  # s
    return np.asarray(np.divide(1.0, share**2, out=np.full(len(share), np.inf), where=share > 0))
