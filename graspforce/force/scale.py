"""Units of a force problem, in which its numbers are of order one, whatever its SI values and the position of O.

    force F    the largest force of the list below
    length L   root mean square distance of the contacts from their centroid
    torque T   of each joint: its load under F, or its bias torque
    cost       the cost of F

F is the largest of: the wrench about the contacts' centroid; the smallest allowed normal forces; the force that brings a joint
back within its limits; for the cost "torque", the force that cancels the bias torques; for "margin", the force at which a limit
ends its growth.

Solvers work on numbers divided by these units, and certificates are relative to them. If a unit were too large, wrong
solutions would pass; if it were too small, no solution would. ``csrc/kernel`` computes the same units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.force.problem import ForceProblem

_NEGLIGIBLE = 1e-14  # of the largest lever arm: smaller ones are rounding errors


@dataclass(frozen=True, eq=False, slots=True)
class Scale:
    """Units of a force problem.

    Args:
        force: unit of force, N.
        length: unit of length, m.
        torque: (n,) unit of torque of each joint, N·m.
        cost: unit of the cost, in the unit of the objective.
    """

    force: float
    length: float
    torque: Array
    cost: float


def scale(problem: ForceProblem) -> Scale:
    """Return the units of a problem. They scale with the problem's units and do not depend on O.

    Args:
        problem: the force problem.
    """
    contacts, actuation, kind = problem.contacts, problem.actuation, problem.objective.type
    fx, fy, fz, mx, my, mz = problem.w_centred.tolist()  # N, N·m
    force = max(math.hypot(fx, fy, fz), math.hypot(mx, my, mz) / problem.length, float(contacts.min_normal.max()))  # N
    lever_arms, bias = joint_lever_arms(problem), np.zeros(0)
    stiffness = float(contacts.mu[contacts.mu > 0].min()) if kind == "margin" else 1.0
    if actuation is not None:
        bias = np.abs(actuation.tau_u)  # N·m
        excess = np.maximum(actuation.lower - actuation.tau_u, actuation.tau_u - actuation.upper)  # N·m, < 0 inside the limits
        force = max(force, float(_ratio_or_zero(np.maximum(excess, 0.0), lever_arms).max(initial=0.0)))
        if kind == "torque":
            root = np.sqrt(actuation.weight)
            lever = float((root * lever_arms).max(initial=0.0))
            force = max(force, float(_ratio_or_zero((root * bias * (lever_arms > 0.0)).max(initial=0.0), lever)))
            stiffness = lever * lever + problem.objective.force_weight
    if kind == "margin":
        force = max(force, _margin_force_limit(problem, lever_arms))
    # without any required force: the force that the bias torques correspond to, or 1 N
    force = force or float(_ratio_or_zero(bias.max(initial=0.0), lever_arms.max(initial=0.0))) or 1.0
    floor = np.where((bias == 0.0) & (lever_arms == 0.0), 1.0, bias)  # N·m
    cost = stiffness * (force * force if kind in ("torque", "force") else force)
    return Scale(force, problem.length, np.maximum(lever_arms * force, floor), cost or 1.0)


def joint_lever_arms(problem: ForceProblem) -> Array:
    """Return (n,) the largest load of each joint by a unit force at any contact, N·m per N; rounding errors count as 0.

    Args:
        problem: the force problem.
    """
    if problem.actuation is None:
        return np.zeros(0)
    lever_arms = (np.abs(problem.actuation.J) * problem.transmissible_units).max(axis=0, initial=0.0)
    return np.asarray(lever_arms * (lever_arms > _NEGLIGIBLE * lever_arms.max(initial=0.0)))


def _ratio_or_zero(size: Array | float, lever: Array | float) -> Array:
    """Return size / lever, 0 where the lever is 0."""
    return np.asarray(size / np.where(np.greater(lever, 0.0), lever, np.inf))


def _margin_force_limit(problem: ForceProblem, lever_arms: Array) -> float:
    """Return the force at which the first limit ends the growth of the margin, N."""
    contacts, actuation = problem.contacts, problem.actuation
    force_limits = contacts.max_normal[(contacts.mu > 0) & (contacts.max_normal > 0)]
    if actuation is not None:
        torque_range = np.maximum(actuation.upper - actuation.tau_u, actuation.tau_u - actuation.lower)  # N·m
        loaded = (lever_arms > 0) & (torque_range > 0)
        force_limits = np.append(force_limits, torque_range[loaded] / lever_arms[loaded])
    ends = force_limits[np.isfinite(force_limits)]
    return float(ends.min()) if ends.size else 0.0
