"""A plan held against every limit on a fine grid, through the hand's own dynamics and the contacts' own cones.

Nothing here knows how the plan was made: poses and postures come from its interpolation, the wrench from Newton's and Euler's
laws, motor torques from the hand's inverse dynamics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce import friction
from graspforce.arrays import Array
from graspforce.grasp import RANK, characteristic_length, grasp_matrix
from graspforce.planning.plan import Check, Motion, Plan
from graspforce.planning.task import Task

TOLERANCE = 1e-3  # of each limit
_NONE = -np.inf


@dataclass(frozen=True, eq=False, slots=True)
class Excess:
    """By how much a motion exceeds its limits at M times; negative inside.

    Args:
        slip: (M, N) N.
        normal: (M, N) N.
        torque: (M, n) N·m.
        speed: (M, n) rad/s.
        position: (M, n) rad.
        drift: (M, N) how far the tips are from their contacts, m.
        unmet: (M, 6) the wrench that no forces at the contacts make, N and N·m.
        imbalance: (M, 6) the wrench that the motion's own forces miss, N and N·m.
        w: (M, 6) the wrench that the object needs.
        friction: (N,) the largest friction μ f_n of each contact, N.
    """

    slip: Array
    normal: Array
    torque: Array
    speed: Array
    position: Array
    drift: Array
    unmet: Array
    imbalance: Array
    w: Array
    friction: Array


def excess(task: Task, motion: Motion) -> Excess:
    """What a motion exceeds, its forces corrected by the least that gives the object the wrench it needs."""
    M, hand, contacts, body = len(motion.times), task.hand, task.contacts, task.body
    none: Array = np.zeros((M, 0))
    w, missed, unmet, f = np.zeros((M, 6)), np.zeros((M, 6)), np.zeros((M, 6)), motion.f
    slip, normal, drift, largest = none, none, none, np.zeros(0)
    if body is not None and contacts is not None:
        spin, turn = motion.twist[:, 3:], motion.acceleration[:, 3:]
        in_O = [np.einsum("mji,mj->mi", motion.R_HO, x) for x in (motion.acceleration[:, :3] - task.gravity_H, spin, turn)]
        w = body.wrench_along(*in_O)
        G = grasp_matrix(contacts)
        missed = w - f @ G.T
        length = characteristic_length(contacts)
        unit = np.array([1.0, 1.0, 1.0, length, length, length])
        f = f + missed / unit @ np.linalg.pinv(G / unit[:, None], rcond=RANK).T
        unmet = w - f @ G.T
        flat = np.zeros((M, 4 * len(contacts)))
        flat[:, contacts.columns] = f
        padded = flat.reshape(M, -1, 4)
        pressing = padded[:, :, friction.N]
        rough = contacts.mu > 0.0
        slip = np.where(rough, task.slip_margin - friction.slip_margin(padded, contacts.mu, contacts.gamma), _NONE)
        largest = np.maximum(pressing.max(axis=0) * contacts.mu, 1e-300)
        normal = np.maximum(pressing - contacts.max_normal, contacts.min_normal - pressing)
    torque, speed, position = none, none, none
    if hand is not None:
        tau = hand.inverse_dynamics_along(motion.q, motion.v, motion.a, task.gravity_H)
        if contacts is not None:
            J = hand.contact_jacobian_along(motion.q, task.fingers, contacts, motion.p_HO, motion.R_HO)
            tau = tau + np.einsum("mkn,mk->mn", J, f)
            tips, _ = hand.tips_along(motion.q, task.fingers)
            places = motion.p_HO[:, None] + task.ball_centres @ motion.R_HO.transpose(0, 2, 1)
            drift = np.linalg.norm(tips - places, axis=2)
        torque = np.maximum(tau - hand.torque_upper, hand.torque_lower - tau)
        speed = np.abs(motion.v) - hand.velocity_limit
        position = np.maximum(motion.q - hand.q_upper, hand.q_lower - motion.q)
    return Excess(slip, normal, torque, speed, position, drift, unmet, missed, w, largest)


def times_between(knots: Array, each: int) -> Array:
    """(M,) the knots, and ``each`` times evenly inside every interval between them, in order."""
    inside = knots[:-1, None] + np.diff(knots)[:, None] * np.arange(each + 1) / (each + 1)
    return np.append(inside.ravel(), knots[-1])


def check(plan: Plan, each: int = 3, tolerance: float = TOLERANCE) -> tuple[Check, Excess]:
    """A plan's check, and by how much it exceeds its limits at the `times_between` its knots.

    Args:
        plan: the plan; its own check is not looked at.
        each: how many times inside every interval.
        tolerance: the excess that is let pass, as part of each limit.
    """
    task, times = plan.task, times_between(plan.knots.times, each)
    over = excess(task, plan.at(times))
    hand, contacts = task.hand, task.contacts
    parts = {"slip": _NONE, "normal": _NONE, "torque": _NONE, "speed": _NONE, "position": _NONE}
    drift = unmet = imbalance = 0.0
    if contacts is not None:
        parts["slip"] = float((over.slip / over.friction).max())
        bounded = np.where(np.isfinite(contacts.max_normal) & (contacts.max_normal > 0), contacts.max_normal, 1.0)
        parts["normal"] = float((over.normal / bounded).max())
        length = characteristic_length(contacts)
        unit = np.array([1.0, 1.0, 1.0, length, length, length])
        largest, unmet, imbalance = (
            float(np.linalg.norm(wrench / unit, axis=1).max()) for wrench in (over.w, over.unmet, over.imbalance)
        )
        unmet, imbalance = unmet / (largest or 1.0), imbalance / (largest or 1.0)
        drift = float(over.drift.max(initial=0.0))
    if hand is not None:
        parts["torque"] = float((over.torque / hand.torque_upper).max())
        parts["speed"] = float((over.speed / hand.velocity_limit).max())
        parts["position"] = float((over.position / (hand.q_upper - hand.q_lower)).max())
    return Check(**parts, drift=drift, unmet=unmet, imbalance=imbalance, samples=len(times), tolerance=tolerance), over
