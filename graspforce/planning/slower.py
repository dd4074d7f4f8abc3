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
from graspforce.planning.verify import check, loads
from graspforce.problem import ForceProblem, Objective
from graspforce.solve import solve

_SEEN = 0.98  # of the tolerance: the most that a mended plan may use of it
_WORTH = 0.8  # likewise the least: what is slower than that is looked at again
_TRIES = 12  # checks
_LOST = 1e-5  # m: tips this far from their contacts are no plan, however slow
_LONGEST = 2.0  # times the duration: a motion that needs more is not mended but wrong
_ROOM = 0.7  # of a limit that rest leaves, about: what is exceeded falls by that much when all haste is gone
_STRIDE = 5  # knots from one at which resting forces are sought to the next


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

    # Shares 1/σ² with their excesses: the last that were too fast, and the last that was slow enough.
    fast, faster, slow = (1.0, _excess(plan, tolerance)), (2.0, _ROOM + _excess(plan, tolerance)), (0.0, -np.inf)
    best: Plan | None = None
    for _ in range(_TRIES):
        share = _between(slow, fast, faster, (_WORTH + _SEEN) / 2.0 * tolerance)
        if share < 1.0 / _LONGEST**2:
            break
        tried = at(share)
        seen = _excess(tried, tolerance)
        if _kept(tried, tolerance):
            slow, best = (share, seen), tried
            if seen >= _WORTH * tolerance:
                break
        else:
            fast, faster = (share, seen), fast
    return best


def _excess(plan: Plan, tolerance: float) -> float:
    """What must fall."""
    return max(plan.check.excess, -np.inf if plan.check.verified else 1.5 * tolerance)


def _between(slow: tuple[float, float], fast: tuple[float, float], faster: tuple[float, float], wanted: float) -> float:
    """The share at which the excess is as wanted: by the chord to what is slow enough, or beyond what are both too fast.

    Of a bracket a tenth is cut off at least on either side; steps beyond are of a fifth at most, and not too small to tell.
    """
    other = slow if np.isfinite(slow[1]) else faster
    slope = max((fast[1] - other[1]) / (fast[0] - other[0]), 1e-3)
    share = fast[0] - (fast[1] - wanted) / slope
    if np.isfinite(slow[1]):
        margin = 0.1 * (fast[0] - slow[0])
        return min(max(share, slow[0] + margin), fast[0] - margin)
    return min(max(share, 0.8 * fast[0]), fast[0] - 0.1 * wanted)


def _kept(plan: Plan, tolerance: float) -> bool:
    """Whether limits are kept, with a little to spare."""
    return plan.check.verified and plan.check.excess <= _SEEN * tolerance


def resting_forces(task: Task, motion: Motion) -> Array | None:
    """(K, k) forces that hold the object still where the motion has it, half way from the least torques to the most margin.

    Sought at some knots; between them from both sides, corrected by the least that holds the object. None where it cannot be
    held.
    """
    if task.contacts is None:
        return np.zeros(motion.f.shape)
    last = len(motion.f) - 1
    at = np.unique(np.append(np.arange(0, last, _STRIDE), last))
    forces = np.zeros((len(at), task.components))
    for i, k in enumerate(at):
        contacts = task.touching(motion.p_OC[k], motion.R_OC[k])
        problem = task.resting(motion.R_HO[k], motion.p_HO[k], motion.q[k], contacts)
        least = solve(problem, explain=False)
        most = solve(ForceProblem(problem.contacts, problem.w, problem.hand, objective=Objective("margin")), explain=False)
        if not least.found:
            return None
        forces[i] = (least.f + most.f) / 2.0 if most.found else least.f
    f = np.column_stack([np.interp(np.arange(last + 1), at, column) for column in forces.T])
    rates = {name: np.zeros(getattr(motion, name).shape) for name in ("v", "a", "twist", "acceleration", "p_OC_d")}
    return loads(task, replace(motion, f=f, **rates)).f


def _slowed(task: Task, motion: Motion, resting: Array, share: float) -> Motion:
    rate = np.sqrt(share)
    f = resting + share * (motion.f - resting)
    slower = {name: rate * getattr(motion, name) for name in ("v", "twist", "p_OC_d")}
    milder = {name: share * getattr(motion, name) for name in ("a", "acceleration")}
    return with_torques(task, replace(motion, times=motion.times / rate, f=f, **slower, **milder))
