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

from graspforce.core.arrays import Array
from graspforce.force.problem import ForceProblem, Objective
from graspforce.force.solver import solve
from graspforce.planning.check import check, loads
from graspforce.planning.loads import with_torques
from graspforce.planning.plan import Plan, Trajectory
from graspforce.planning.task import Task

_MAX_TOLERANCE_USE = 0.98  # of the tolerance: the most that a mended plan may use of it
_MIN_TOLERANCE_USE = 0.8  # likewise the least: what is slower than that is looked at again
_MAX_CHECKS = 12  # checks
_MAX_DRIFT = 1e-5  # m: tips this far from their contacts are no plan, however slow
_MAX_TIME_SCALE = 2.0  # times the duration: a motion that needs more is not mended but wrong
_REST_MARGIN = 0.7  # of a limit that rest leaves, about: what is exceeded falls by that much when all haste is gone
_KNOT_STRIDE = 5  # knots from one at which resting forces are sought to the next


def slow_down_to_limits(plan: Plan, tolerance: float) -> Plan | None:
    """The plan, slowed until its check finds nothing; None where slowing does not help.

    Args:
        plan: with its check.
        tolerance: of the check.
    """
    if _passes(plan, tolerance):
        return plan
    if plan.check.drift > _MAX_DRIFT:
        return None
    resting = static_forces(plan.task, plan.knots)
    if resting is None:
        return None

    def at(share: float) -> Plan:
        tried = replace(plan, knots=_slowed(plan.task, plan.knots, resting, share))
        return replace(tried, check=check(tried, tolerance)[0])

    # Shares 1/σ² with their excesses: the last that were too fast, and the last that was slow enough.
    fast, faster, slow = (1.0, _excess(plan, tolerance)), (2.0, _REST_MARGIN + _excess(plan, tolerance)), (0.0, -np.inf)
    best: Plan | None = None
    for _ in range(_MAX_CHECKS):
        share = _next_share(slow, fast, faster, (_MIN_TOLERANCE_USE + _MAX_TOLERANCE_USE) / 2.0 * tolerance)
        if share < 1.0 / _MAX_TIME_SCALE**2:
            break
        tried = at(share)
        seen = _excess(tried, tolerance)
        if _passes(tried, tolerance):
            slow, best = (share, seen), tried
            if seen >= _MIN_TOLERANCE_USE * tolerance:
                break
        else:
            fast, faster = (share, seen), fast
    return best


def _excess(plan: Plan, tolerance: float) -> float:
    """What must fall."""
    return max(plan.check.excess, -np.inf if plan.check.verified else 1.5 * tolerance)


def _next_share(slow: tuple[float, float], fast: tuple[float, float], faster: tuple[float, float], wanted: float) -> float:
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


def _passes(plan: Plan, tolerance: float) -> bool:
    """Whether limits are kept, with a little to spare."""
    return plan.check.verified and plan.check.excess <= _MAX_TOLERANCE_USE * tolerance


def static_forces(task: Task, trajectory: Trajectory) -> Array | None:
    """(K, k) forces that hold the object still where the motion has it, half way from the least torques to the most margin.

    Sought at some knots; between them from both sides, corrected by the least that holds the object. None where it cannot be
    held.
    """
    if task.contacts is None:
        return np.zeros(trajectory.f.shape)
    last = len(trajectory.f) - 1
    at = np.unique(np.append(np.arange(0, last, _KNOT_STRIDE), last))
    forces = np.zeros((len(at), task.force_size))
    for i, k in enumerate(at):
        contacts = task.contacts_at(trajectory.p_OC[k], trajectory.R_OC[k])
        problem = task.static_problem(trajectory.R_HO[k], trajectory.p_HO[k], trajectory.q[k], contacts)
        least = solve(problem, explain=False)
        most = solve(ForceProblem(problem.contacts, problem.w, problem.actuation, objective=Objective("margin")), explain=False)
        if not least.found:
            return None
        forces[i] = (least.f + most.f) / 2.0 if most.found else least.f
    f = np.column_stack([np.interp(np.arange(last + 1), at, column) for column in forces.T])
    rates = {name: np.zeros(getattr(trajectory, name).shape) for name in ("v", "a", "twist", "acceleration", "p_OC_d")}
    return loads(task, replace(trajectory, f=f, **rates)).f


def _slowed(task: Task, trajectory: Trajectory, resting: Array, share: float) -> Trajectory:
    rate = np.sqrt(share)
    f = resting + share * (trajectory.f - resting)
    slower = {name: rate * getattr(trajectory, name) for name in ("v", "twist", "p_OC_d")}
    milder = {name: share * getattr(trajectory, name) for name in ("a", "acceleration")}
    return with_torques(task, replace(trajectory, times=trajectory.times / rate, f=f, **slower, **milder))
