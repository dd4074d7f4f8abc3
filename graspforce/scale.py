"""The problem's own units: what makes residuals small numbers, whatever the units of force and length.

Force unit F: the wrench's size (moments over L), or the least normal forces where these are larger, or what the bias torques
alone would press; 1 N where nothing sets the forces. Length unit L: the contacts' rms distance from their centroid. Torque
unit T: what F loads the hardest-loaded motor with. Cost unit: the objective of forces F. All follow the problem when its
units change.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from graspforce import friction
from graspforce.arrays import Array
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
    bias = 0.0 if problem.hand is None else problem.hand.largest_bias  # N·m
    return _scale(problem, problem.w.tolist(), problem.reach, bias)


def row_scales(problem: ForceProblem, rows: Mapping[str, Array], count: int) -> Array:
    """(count, 4) force, length, torque and cost unit of problems that differ from one in some arrays.

    Args:
        problem: what all share.
        rows: "w", "J", "tau_u": arrays whose first axis is the problem's number.
        count: how many problems.
    """
    hand, contacts = problem.hand, problem.contacts
    wrenches = rows["w"].tolist() if "w" in rows else [problem.w.tolist()] * count
    reaches, biases = [problem.reach] * count, [0.0 if hand is None else hand.largest_bias] * count
    if "J" in rows:
        unit = np.where(contacts.columns % 4 == friction.M, problem.length, 1.0)  # 1, m
        reaches = (np.abs(rows["J"]) * unit[:, None]).max(axis=(1, 2), initial=0.0).tolist()
    if "tau_u" in rows:
        biases = np.abs(rows["tau_u"]).max(axis=1, initial=0.0).tolist()
    units = (_scale(problem, *each) for each in zip(wrenches, reaches, biases, strict=True))
    return np.array([(unit.force, unit.length, unit.torque, unit.cost) for unit in units])


def _scale(problem: ForceProblem, w: list[float], reach: float, bias: float) -> Scale:
    hand, length = problem.hand, problem.length
    fx, fy, fz, mx, my, mz = w  # N, N·m
    force = max(math.hypot(fx, fy, fz), math.hypot(mx, my, mz) / length, problem.contacts.largest_minimum)  # N
    if force == 0.0:
        force = bias / reach if bias > 0.0 and reach > 0.0 else 1.0
    torque = reach * force or bias or 1.0  # N·m
    if problem.objective.type == "torque":
        assert hand is not None  # checked when the problem was made
        cost = hand.largest_weight * torque * torque + problem.objective.force_weight * force * force
    else:
        cost = force * force if problem.objective.type == "force" else force
    return Scale(force, length, torque, cost or 1.0)
