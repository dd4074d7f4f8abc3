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

_SEEN = 0.98  # of the tolerance: what a mended plan may use of it
_TRIES = 8  # steps towards a motion that is slow enough
_HALVINGS = 4  # between that and the last that was not
_LOST = 1e-5  # m: tips this far from their contacts are no plan, however slow
_LONGEST = 2.0  # times the duration: a motion that needs more is not mended but wrong
_ROOM = 0.5  # of a limit that rest leaves, about: what is exceeded falls by that much when all haste is gone


def slowed_enough(plan: Plan, tolerance: float) -> Plan | None:
    """The plan, slowed until its check finds nothing; None where slowing does not help.

    Args:
        plan: with its check.
        tolerance: of the check.
    """
    if _kept(plan, tolerance):
        return plan
    if plan.check.drift > _LOST:
        return None
    resting = resting_forces(plan.task, plan.knots)
    if resting is None:
        return None

    def at(share: float) -> Plan:
        tried = replace(plan, knots=_slowed(plan.task, plan.knots, resting, share))
        return replace(tried, check=check(tried, tolerance)[0])

    fast, slow, best = 1.0, 1.0, plan  # shares 1/σ²
    for _ in range(_TRIES):
        fast, slow = slow, slow * (1.0 - min(0.2, max(best.check.excess, 1.5 * tolerance) / _ROOM))
        best = at(slow)
        if _kept(best, tolerance) or slow < 1.0 / _LONGEST**2:
            break
    if not _kept(best, tolerance):
        return None
    for _ in range(_HALVINGS):
        between = at((fast + slow) / 2.0)
        if _kept(between, tolerance):
            slow, best = (fast + slow) / 2.0, between
        else:
            fast = (fast + slow) / 2.0
    return best


def _kept(plan: Plan, tolerance: float) -> bool:
    """Whether limits are kept, between the times that are looked at too."""
    return plan.check.verified and plan.check.excess <= _SEEN * tolerance


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
