"""The units in which the numbers of a force problem are small, whatever its own units and wherever O stands.

    force F    what sets the forces of the answer: the wrench about the contacts' centroid, the least normal forces, what a
               joint outside its limits demands, the bias torques that the torque cost would cancel, and for "margin" the
               limit that ends it
    length L   rms distance of the contacts from their centroid
    torque T   a joint's own: what F loads it with, or its bias torque
    cost       what F costs

Solvers are given numbers over these units and certificates judge by them. A unit that is too large would let wrong answers
pass, one that is too small would let none pass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from graspforce.arrays import Array
from graspforce.problem import ForceProblem

_NEGLIGIBLE = 1e-14  # a joint that forces load less than this beside the most loaded one is loaded by rounding alone


@dataclass(frozen=True, eq=False, slots=True)
class Scale:
    """The problem's own units: force, N; length, m; torque of each joint (n,), N·m; cost in the objective's unit."""

    force: float
    length: float
    torque: Array
    cost: float


@dataclass(frozen=True, eq=False, slots=True)
class ScaleRows:
    """The units of M problems: force (M,), N; length, m; torque (M, n), N·m; cost (M,)."""

    force: Array
    length: float
    torque: Array
    cost: Array


@dataclass(frozen=True, eq=False, slots=True)
class Standing:
    """What the units depend on apart from the wrench; a leading axis M where J or tau_u is M-fold.

    Args:
        length: L, m.
        least: the force that is asked for whatever the wrench, N.
        reach: (n,) what a newton loads each joint with at most, N·m per N.
        bias: (n,) the size of each bias torque, N·m.
        floor: (n,) the least torque unit: the bias torque, or 1 where nothing loads the joint, N·m.
        stiffness: what a newton costs, in the objective's unit over N or N².
        quadratic: whether the cost grows with the square of the forces.
    """

    length: float
    least: Array
    reach: Array
    bias: Array
    floor: Array
    stiffness: Array
    quadratic: bool


def scale(problem: ForceProblem) -> Scale:
    """The units of a problem; all follow when its units change, and none when O moves."""
    return rescaled(standing(problem), problem.w_centred)


def rescaled(fixed: Standing, w: Array) -> Scale:
    """The units of one problem for a wrench.

    Args:
        fixed: the rest of the problem.
        w: (6,) the wrench about the contacts' centroid, N and N·m.
    """
    fx, fy, fz, mx, my, mz = w.tolist()  # N, N·m
    force = max(math.hypot(fx, fy, fz), math.hypot(mx, my, mz) / fixed.length, float(fixed.least))  # N
    force = force or float(_bias_force(fixed))
    cost = float(fixed.stiffness) * (force * force if fixed.quadratic else force)
    return Scale(force, fixed.length, np.maximum(fixed.reach * force, fixed.floor), cost or 1.0)


def rescaled_rows(fixed: Standing, w: Array, count: int) -> ScaleRows:
    """The units of M problems, as `rescaled` has them for one.

    Args:
        fixed: the rest of the problems, M-fold or of all.
        w: (M, 6) or (6,) wrenches about the contacts' centroid, N and N·m.
        count: M.
    """
    pull, turn = np.sqrt((w[..., :3] ** 2).sum(axis=-1)), np.sqrt((w[..., 3:] ** 2).sum(axis=-1))  # N, N·m
    force = np.maximum(np.maximum(pull, turn / fixed.length), fixed.least)  # N
    force = np.broadcast_to(np.where(force == 0.0, _bias_force(fixed), force), (count,))
    cost = fixed.stiffness * (force * force if fixed.quadratic else force)
    torque = np.maximum(fixed.reach * force[:, None], fixed.floor)  # N·m
    return ScaleRows(force, fixed.length, torque, np.where(cost == 0.0, 1.0, cost))


def standing(problem: ForceProblem, J: Array | None = None, tau_u: Array | None = None) -> Standing:
    """What the units depend on apart from the wrench.

    Args:
        problem: the problem.
        J: (M, k, n) Jacobians in place of the problem's own, m/rad.
        tau_u: (M, n) bias torques in place of the problem's own, N·m.
    """
    contacts, hand, kind = problem.contacts, problem.hand, problem.objective.type
    least = contacts.min_normal.max()  # N
    reach, bias = np.zeros(0), np.zeros(0)
    stiffness = contacts.mu[contacts.mu > 0].min() if kind == "margin" else np.float64(1.0)
    if hand is not None:
        reach = _reaches(problem, hand.J if J is None else J)
        signed = hand.tau_u if tau_u is None else tau_u  # N·m
        bias = np.abs(signed)
        beyond = np.maximum(hand.lower - signed, signed - hand.upper)  # N·m, negative inside the limits
        if (beyond > 0.0).any():
            least = np.maximum(least, _over(beyond, reach).max(axis=-1, initial=0.0))
        if kind == "torque":
            root = np.sqrt(hand.weight)
            lever = (root * reach).max(axis=-1, initial=0.0)
            least = np.maximum(least, _over((root * bias * (reach > 0.0)).max(axis=-1, initial=0.0), lever))
            stiffness = lever * lever + problem.objective.force_weight
    if kind == "margin":
        least = np.maximum(least, _widest_margin(problem, reach))
    floor = np.where((bias == 0.0) & (reach == 0.0), 1.0, bias)
    return Standing(problem.length, least, reach, bias, floor, stiffness, kind in ("torque", "force"))


def _reaches(problem: ForceProblem, J: Array) -> Array:
    """(…, n) the most that a unit force at any contact loads each joint with, N·m per N."""
    reach = (np.abs(J) * problem.bearing_units).max(axis=-2, initial=0.0)
    return np.asarray(reach * (reach > _NEGLIGIBLE * reach.max(axis=-1, keepdims=True, initial=0.0)))


def _bias_force(fixed: Standing) -> Array:
    """The force where nothing asks for any: what the bias torques alone would press, N; 1 N without any."""
    force = _over(fixed.bias.max(axis=-1, initial=0.0), fixed.reach.max(axis=-1, initial=0.0))
    return np.where(force == 0.0, 1.0, force)


def _over(size: Array, lever: Array) -> Array:
    """size / lever, zero where there is no lever."""
    return np.asarray(size / np.where(lever > 0.0, lever, np.inf))


def _widest_margin(problem: ForceProblem, reach: Array) -> float:
    """The force at which the first limit ends the margin's growth, N."""
    contacts, hand = problem.contacts, problem.hand
    pressing = contacts.max_normal[(contacts.mu > 0) & (contacts.max_normal > 0)]
    if hand is not None:
        room = np.maximum(hand.upper - hand.tau_u, hand.tau_u - hand.lower)  # N·m
        loaded = (reach > 0) & (room > 0)
        pressing = np.append(pressing, room[loaded] / reach[loaded])
    ends = pressing[np.isfinite(pressing)]
    return float(ends.min()) if ends.size else 0.0
