"""The units in which the numbers of a force problem are small, whatever its own units and wherever O stands.

    force F    what sets the forces of the answer: the wrench about the contacts' centroid, the least normal forces, what a
               joint outside its limits demands, the bias torques that the torque cost would cancel, and for "margin" the
               limit that ends it
    length L   rms distance of the contacts from their centroid
    torque T   a joint's own: what F loads it with, or its bias torque
    cost       what F costs

What `certify.c` measures by are the same units, from a second writing of this law.

Solvers are given numbers over these units and certificates judge by them. A unit that is too large would let wrong answers
pass, one that is too small would let none pass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.force.problem import ForceProblem

_NEGLIGIBLE = 1e-14  # a joint that forces load less than this beside the most loaded one is loaded by rounding alone


@dataclass(frozen=True, eq=False, slots=True)
class Scale:
    """The problem's own units: force, N; length, m; torque of each joint (n,), N·m; cost in the objective's unit."""

    force: float
    length: float
    torque: Array
    cost: float


def scale(problem: ForceProblem) -> Scale:
    """The units of a problem; all follow when its units change, and none when O moves."""
    contacts, actuation, kind = problem.contacts, problem.actuation, problem.objective.type
    fx, fy, fz, mx, my, mz = problem.w_centred.tolist()  # N, N·m
    force = max(math.hypot(fx, fy, fz), math.hypot(mx, my, mz) / problem.length, float(contacts.min_normal.max()))  # N
    lever_arms, bias = joint_lever_arms(problem), np.zeros(0)
    stiffness = float(contacts.mu[contacts.mu > 0].min()) if kind == "margin" else 1.0
    if actuation is not None:
        bias = np.abs(actuation.tau_u)  # N·m
        beyond = np.maximum(
            actuation.lower - actuation.tau_u, actuation.tau_u - actuation.upper
        )  # N·m, negative inside the limits
        force = max(force, float(_ratio_or_zero(np.maximum(beyond, 0.0), lever_arms).max(initial=0.0)))
        if kind == "torque":
            root = np.sqrt(actuation.weight)
            lever = float((root * lever_arms).max(initial=0.0))
            force = max(force, float(_ratio_or_zero((root * bias * (lever_arms > 0.0)).max(initial=0.0), lever)))
            stiffness = lever * lever + problem.objective.force_weight
    if kind == "margin":
        force = max(force, _margin_force_limit(problem, lever_arms))
    # where nothing asks for any force: what the bias torques alone would press, or 1 N without any
    force = force or float(_ratio_or_zero(bias.max(initial=0.0), lever_arms.max(initial=0.0))) or 1.0
    floor = np.where((bias == 0.0) & (lever_arms == 0.0), 1.0, bias)  # N·m
    cost = stiffness * (force * force if kind in ("torque", "force") else force)
    return Scale(force, problem.length, np.maximum(lever_arms * force, floor), cost or 1.0)


def joint_lever_arms(problem: ForceProblem) -> Array:
    """(n,) the most that a unit force at any contact loads each joint with, N·m per N; zero where it is rounding alone."""
    if problem.actuation is None:
        return np.zeros(0)
    lever_arms = (np.abs(problem.actuation.J) * problem.transmissible_units).max(axis=0, initial=0.0)
    return np.asarray(lever_arms * (lever_arms > _NEGLIGIBLE * lever_arms.max(initial=0.0)))


def _ratio_or_zero(size: Array | float, lever: Array | float) -> Array:
    """size / lever, zero where there is no lever."""
    return np.asarray(size / np.where(np.greater(lever, 0.0), lever, np.inf))


def _margin_force_limit(problem: ForceProblem, lever_arms: Array) -> float:
    """The force at which the first limit ends the margin's growth, N."""
    contacts, actuation = problem.contacts, problem.actuation
    force_limits = contacts.max_normal[(contacts.mu > 0) & (contacts.max_normal > 0)]
    if actuation is not None:
        torque_range = np.maximum(actuation.upper - actuation.tau_u, actuation.tau_u - actuation.lower)  # N·m
        loaded = (lever_arms > 0) & (torque_range > 0)
        force_limits = np.append(force_limits, torque_range[loaded] / lever_arms[loaded])
    ends = force_limits[np.isfinite(force_limits)]
    return float(ends.min()) if ends.size else 0.0
