"""A motion slowed just enough to keep its limits.

Slowed by σ, rates fall with 1/σ and accelerations with 1/σ². The object's wrench and the fingers' own torques are then those of
rest plus 1/σ² of what the motion adds, and with

    f = f_rest + (f_motion − f_rest)/σ²

so are contact forces and motor torques. Cones and limits are convex: what rest keeps with room to spare, a motion that breaks
them by little keeps when slowed by little.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graspforce.arrays import Array
from graspforce.planning.free_program import with_torques
from graspforce.planning.plan import Motion, Plan
from graspforce.planning.task import Task
from graspforce.planning.verify import check
from graspforce.problem import ForceProblem, Objective
from graspforce.solve import solve

_TRIES = 12
_AIM = 0.7  # of the tolerance: what excess is left, so that the next try does not miss by a hair
_LONGEST = 2.0  # times the duration: a motion that needs more is not mended but wrong


def slowed_enough(plan: Plan, tolerance: float) -> Plan | None:
    """The plan, slowed until its check finds nothing; None where slowing does not help.

    Args:
        plan: with its check.
        tolerance: of the check.
    """
    if plan.check.verified:
        return plan
    resting: Array | None = None
    share = 1.0  # 1/σ²
    tried = plan
    for _ in range(_TRIES):
        if resting is None:
            resting = resting_forces(plan.task, plan.knots)
            if resting is None:
                return None
        # torques and forces break by less as share falls: about in proportion to the room that rest leaves, taken as a half
        share *= 1.0 - min(0.2, max(tried.check.excess - _AIM * tolerance, 0.1 * tolerance) / 0.5)
        if share < 1.0 / _LONGEST**2:
            return None
        knots = _slowed(plan.task, plan.knots, resting, share)
        tried = replace(plan, knots=knots)
        tried = replace(tried, check=check(tried, tolerance=tolerance)[0])
        if tried.check.verified:
            return tried
    return None


def resting_forces(task: Task, motion: Motion) -> Array | None:
    """(K, k) forces that hold the object still where the motion has it, half way from the least torques to the most margin.

    None where it cannot be held.
    """
    forces = np.zeros(motion.f.shape)
    if task.contacts is None:
        return forces
    for k in range(len(forces)):
        problem = task.resting(motion.R_HO[k], motion.p_HO[k], motion.q[k])
        least = solve(problem, explain=False)
        most = solve(ForceProblem(problem.contacts, problem.w, problem.hand, objective=Objective("margin")), explain=False)
        if not least.found:
            return None
        forces[k] = (least.f + most.f) / 2.0 if most.found else least.f
    return forces


def _slowed(task: Task, motion: Motion, resting: Array, share: float) -> Motion:
    rate = np.sqrt(share)
    f = resting + share * (motion.f - resting)
    v, a, twist, acceleration = rate * motion.v, share * motion.a, rate * motion.twist, share * motion.acceleration
    return with_torques(
        task, Motion(motion.times / rate, motion.q, v, a, motion.tau, f, motion.p_HO, motion.R_HO, twist, acceleration)
    )
