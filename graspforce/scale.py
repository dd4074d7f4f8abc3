"""The problem's own units: what makes residuals small numbers, whatever the units of force and length.

Force unit F: the wrench's size (moments over L), or the least normal forces where these are larger, or what the bias torques
alone would press; 1 N where nothing sets the forces. Length unit L: the contacts' rms distance from their centroid. Torque
unit T: what F loads the hardest-loaded motor with. Cost unit: the objective of forces F. All follow the problem when its
units change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from graspforce.problem import ForceProblem


@dataclass(frozen=True, slots=True)
class Scale:
    """The problem's own units: force, N; length, m; torque, N·m; cost in the objective's unit."""

    force: float
    length: float
    torque: float
    cost: float


def scale(problem: ForceProblem) -> Scale:
    """The units of a problem, as above."""
    hand, length, reach = problem.hand, problem.length, problem.reach
    fx, fy, fz, mx, my, mz = problem.w.tolist()  # N, N·m
    force = max(math.hypot(fx, fy, fz), math.hypot(mx, my, mz) / length, problem.contacts.largest_minimum)  # N
    bias = 0.0 if hand is None else hand.largest_bias  # N·m
    if force == 0.0:
        force = bias / reach if bias > 0.0 and reach > 0.0 else 1.0
    torque = reach * force or bias or 1.0  # N·m
    if problem.objective.type == "torque":
        assert hand is not None  # checked when the problem was made
        cost = hand.largest_weight * torque * torque + problem.objective.force_weight * force * force
    else:
        cost = force * force if problem.objective.type == "force" else force
    return Scale(force, length, torque, cost or 1.0)
