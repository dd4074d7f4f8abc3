"""Loads of a trajectory: the object's wrench, contact forces and motor torques, from the laws of motion.

The wrench follows Newton's and Euler's laws, `Body.wrenches`. The torques follow from the hand's inverse dynamics and
tau += Jᵀ f.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import RANK_TOLERANCE, characteristic_length, contact_jacobians, grasp_matrices
from graspforce.core.arrays import Array
from graspforce.planning.task import FingerTask, GraspTask, HandTask, ObjectTask, Task
from graspforce.planning.tip_contacts import (
    TipContacts,
    constraints,
    contact_jacobians_at,
    drift,
    locate_contacts,
)
from graspforce.planning.trajectory import Trajectory


@dataclass(frozen=True, eq=False, slots=True)
class RequiredLoads:
    """Loads that a trajectory requires at M instants. The forces have the smallest correction that gives the required wrench.

    Args:
        q: (M, n) joint positions, rad.
        v: (M, n) joint velocities, rad/s.
        a: (M, n) joint accelerations, rad/s².
        acceleration: (M, 6) p̈ of O and α in H, m/s² and rad/s²; zero without an object.
        tau: (M, n) motor torques, N·m.
        f: (M, k) stacked contact forces, N and N·m.
        drift: (M, N) contact errors, m: height over the surface, accumulated slip, or distance from the planned contact.
        unmet: (M, 6) part of the wrench that the contacts cannot supply, N and N·m.
        imbalance: (M, 6) wrench that the trajectory's own forces miss, N and N·m.
        w: (M, 6) required wrench about O, in O, N and N·m.
    """

    q: Array
    v: Array
    a: Array
    acceleration: Array
    tau: Array
    f: Array
    drift: Array
    unmet: Array
    imbalance: Array
    w: Array


def required_loads(task: Task, trajectory: Trajectory) -> RequiredLoads:
    """Return the loads that a trajectory requires.

    Args:
        task: the task.
        trajectory: states at M instants.
    """
    M = len(trajectory.times)
    q, v, a, acceleration = trajectory.q, trajectory.v, trajectory.a, trajectory.acceleration
    if isinstance(task, FingerTask):
        none = np.zeros((M, 6))
        tau = _motor_torques(task, trajectory)
        return RequiredLoads(q, v, a, none, tau, trajectory.f, np.zeros((M, 0)), none, none, none)
    if isinstance(task, GraspTask):
        now = locate_contacts(task, trajectory.q, trajectory.p_HO, trajectory.R_HO)
        f, unmet, imbalance, w = _balanced_forces(task, trajectory, now.p_OC, now.R_OC)
        J = contact_jacobians(task.contacts, now.contact_twists, trajectory.R_HO, now.R_OC)
        tau = _motor_torques(task, trajectory) + (J.swapaxes(1, 2) @ f[:, :, None])[:, :, 0]
        return RequiredLoads(q, v, a, acceleration, tau, f, _contact_errors(task, trajectory, now), unmet, imbalance, w)
    f, unmet, imbalance, w = _balanced_forces(task, trajectory, trajectory.p_OC, trajectory.R_OC)
    return RequiredLoads(q, v, a, acceleration, np.zeros((M, 0)), f, np.zeros((M, 0)), unmet, imbalance, w)


def with_torques(task: Task, trajectory: Trajectory) -> Trajectory:
    """Return a trajectory with the motor torques that its motion and contact forces require.

    Args:
        task: the task.
        trajectory: states; their torques are ignored.
    """
    tau = np.zeros((len(trajectory.times), 0))
    if isinstance(task, HandTask):
        tau = _motor_torques(task, trajectory)
    if isinstance(task, GraspTask):
        J = contact_jacobians_at(task, trajectory.q, trajectory.p_HO, trajectory.R_HO, trajectory.p_OC, trajectory.R_OC)
        tau = tau + np.einsum("mkn,mk->mn", J, trajectory.f)
    return replace(trajectory, tau=tau).frozen()


def wrench_scale(contacts: ContactSet) -> Array:
    """Return the scale (6,) of a wrench: 1 for forces and the contacts' characteristic length, m, for moments."""
    length = characteristic_length(contacts)
    return np.array([1.0, 1.0, 1.0, length, length, length])


def _balanced_forces(task: ObjectTask, trajectory: Trajectory, p_OC: Array, R_OC: Array) -> tuple[Array, Array, Array, Array]:
    """Return f, unmet, imbalance and w of `RequiredLoads`, with the contacts at p_OC, R_OC."""
    w = _required_wrenches(task, trajectory)
    G, scale = grasp_matrices(task.contacts, p_OC, R_OC), wrench_scale(task.contacts)
    imbalance = w - (G @ trajectory.f[:, :, None])[:, :, 0]
    inverse = np.linalg.pinv(G / scale[:, None], rcond=RANK_TOLERANCE)
    f = trajectory.f + (inverse @ (imbalance / scale)[:, :, None])[:, :, 0]
    return f, w - (G @ f[:, :, None])[:, :, 0], imbalance, w


def _required_wrenches(task: ObjectTask, trajectory: Trajectory) -> Array:
    """Return the wrenches (M, 6) that move the object along the trajectory, about O in O, N and N·m."""
    acceleration = trajectory.acceleration
    vectors_H = (acceleration[:, :3] - task.gravity_H, trajectory.twist[:, 3:], acceleration[:, 3:])
    return task.body.wrenches(*(np.einsum("mji,mj->mi", trajectory.R_HO, x) for x in vectors_H))


def _motor_torques(task: HandTask, trajectory: Trajectory) -> Array:
    """Return the motor torques (M, n) that the motion of the hand requires without contacts, N·m."""
    return task.hand.inverse_dynamics_along(trajectory.q, trajectory.v, trajectory.a, task.gravity_H)


def _contact_errors(task: GraspTask, trajectory: Trajectory, now: TipContacts) -> Array:
    """Return the contact errors (M, N) of `RequiredLoads`, m; slip is integrated by the trapezoidal rule."""
    omega = np.einsum("mji,mj->mi", trajectory.R_HO, trajectory.twist[:, 3:])  # rad/s, in O
    A, b = constraints(task, now, trajectory.R_HO, trajectory.twist[:, :3], omega)
    rows, _ = task.constrained
    slip_rates = np.zeros((len(A), len(rows)))
    slip_rates[:, rows] = ((A @ trajectory.v[:, :, None])[:, :, 0] - b)[:, : int(rows.sum())]
    speed = np.linalg.norm(slip_rates.reshape(len(A), -1, 3), axis=2)  # m/s
    slip = np.zeros(speed.shape)
    slip[1:] = np.cumsum((speed[1:] + speed[:-1]) / 2.0 * np.diff(trajectory.times)[:, None], axis=0)
    offsets = np.linalg.norm(now.p_OC - trajectory.p_OC, axis=2)
    return np.asarray(np.maximum.reduce([drift(task, now), offsets, np.where(task.is_rolling, slip, 0.0)]))
