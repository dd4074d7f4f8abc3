"""Time scaling of a plan that exceeds its limits a little: slow it down just enough.

With time scaled by σ, rates fall by 1/σ and accelerations by 1/σ². The wrench of the object and the fingers' torques are then
those at rest plus 1/σ² of what the motion adds, and so are contact forces and motor torques with

    f = f_rest + (f_motion − f_rest)/σ²

Cones and limits are convex. If the state of rest keeps them strictly, slowing down a little removes a small excess.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from graspforce.core.arrays import Array
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.solver import solve
from graspforce.planning.check import check
from graspforce.planning.loads import required_loads, with_torques
from graspforce.planning.plan import Plan
from graspforce.planning.task import FingerTask, Task
from graspforce.planning.tip_contacts import contacts_at
from graspforce.planning.trajectory import Trajectory

_MAX_TOLERANCE_USE = 0.98  # of the tolerance: largest excess of a slowed plan
_MIN_TOLERANCE_USE = 0.8  # of the tolerance: a plan with less excess is slower than necessary and is tried again
_MAX_CHECKS = 12
_MAX_DRIFT = 1e-5  # m: a plan with larger contact errors is not worth slowing down
_MAX_TIME_SCALE = 2.0  # σ: a plan that needs more is not worth slowing down
_REST_MARGIN = 0.7  # of a limit, typical: the excess falls by this much as σ → ∞
_KNOT_STRIDE = 5  # knots between two at which forces at rest are solved for


@dataclass(frozen=True, slots=True)
class _Trial:
    """A share 1/σ² of the motion's accelerations, and the excess of the plan with it."""

    share: float
    excess: float


def slow_down_to_limits(plan: Plan, tolerance: float) -> Plan | None:
    """Return the plan, slowed down until it passes its check; None if slowing down does not help.

    Args:
        plan: the plan with its check.
        tolerance: largest excess of a limit between knots, relative to the limit.
    """
    if _passes(plan, tolerance):
        return plan
    if plan.check.drift > _MAX_DRIFT:
        return None
    rest_forces = static_forces(plan.task, plan.knots)
    if rest_forces is None:
        return None
    target = (_MIN_TOLERANCE_USE + _MAX_TOLERANCE_USE) / 2.0 * tolerance
    too_fast, before = _Trial(1.0, _excess(plan, tolerance)), _Trial(2.0, _REST_MARGIN + _excess(plan, tolerance))
    slow_enough: _Trial | None = None
    best: Plan | None = None
    for _ in range(_MAX_CHECKS):
        share = _next_share(slow_enough, too_fast, before, target)
        if share < 1.0 / _MAX_TIME_SCALE**2:
            break
        slowed = replace(plan, knots=_slowed(plan.task, plan.knots, rest_forces, share))
        slowed = replace(slowed, check=check(slowed, tolerance)[0])
        trial = _Trial(share, _excess(slowed, tolerance))
        if _passes(slowed, tolerance):
            slow_enough, best = trial, slowed
            if trial.excess >= _MIN_TOLERANCE_USE * tolerance:
                break
        else:
            too_fast, before = trial, too_fast
    return best


def static_forces(task: Task, trajectory: Trajectory) -> Array | None:
    """Return contact forces (K, k) that hold the object still in the poses of a trajectory, N and N·m.

    They lie halfway between those with the least torques and those with the largest slip margin. They are solved for at some
    knots; between these they are interpolated, with the smallest correction that gives equilibrium.

    Args:
        task: the task.
        trajectory: states at K knots.

    Returns:
        The forces, or None if the object cannot be held still at one of the knots.
    """
    if isinstance(task, FingerTask):
        return np.zeros(trajectory.f.shape)
    last = len(trajectory.f) - 1
    knots = np.unique(np.append(np.arange(0, last, _KNOT_STRIDE), last))
    forces = np.zeros((len(knots), task.force_size))
    for i, k in enumerate(knots):
        contacts = contacts_at(task.contacts, trajectory.p_OC[k], trajectory.R_OC[k])
        problem = task.static_problem(trajectory.p_HO[k], trajectory.R_HO[k], trajectory.q[k], contacts)
        margin_problem = ForceProblem(problem.contacts, problem.w, problem.actuation, objective=Objective("margin"))
        least, safest = solve(problem, explain=False), solve(margin_problem, explain=False)
        if not least.found:
            return None
        forces[i] = (least.f + safest.f) / 2.0 if safest.found else least.f
    f = np.column_stack([np.interp(np.arange(last + 1), knots, column) for column in forces.T])
    rest = {name: np.zeros(getattr(trajectory, name).shape) for name in ("v", "a", "twist", "acceleration", "p_OC_d")}
    return required_loads(task, replace(trajectory, f=f, **rest)).f


def _excess(plan: Plan, tolerance: float) -> float:
    """Return the plan's largest excess; above the tolerance if the plan fails its check in another way."""
    return max(plan.check.excess, -np.inf if plan.check.verified else 1.5 * tolerance)


def _next_share(slow_enough: _Trial | None, too_fast: _Trial, before: _Trial, target: float) -> float:
    """Return the share at which a secant through two trials has the target excess.

    The secant goes through ``too_fast`` and ``slow_enough``, or, without the latter, through ``before``. It stays a tenth
    inside a bracket; without a bracket, a step is a fifth at most and large enough to have an effect.
    """
    other = before if slow_enough is None else slow_enough
    slope = max((too_fast.excess - other.excess) / (too_fast.share - other.share), 1e-3)
    share = too_fast.share - (too_fast.excess - target) / slope
    if slow_enough is None:
        return min(max(share, 0.8 * too_fast.share), too_fast.share - 0.1 * target)
    margin = 0.1 * (too_fast.share - slow_enough.share)
    return min(max(share, slow_enough.share + margin), too_fast.share - margin)


def _passes(plan: Plan, tolerance: float) -> bool:
    """Return whether a plan passes its check with a small margin."""
    return plan.check.verified and plan.check.excess <= _MAX_TOLERANCE_USE * tolerance


def _slowed(task: Task, trajectory: Trajectory, rest_forces: Array, share: float) -> Trajectory:
    """Return a trajectory slowed down by σ = 1/√share."""
    rate = np.sqrt(share)
    f = rest_forces + share * (trajectory.f - rest_forces)
    rates = {name: rate * getattr(trajectory, name) for name in ("v", "twist", "p_OC_d")}
    accelerations = {name: share * getattr(trajectory, name) for name in ("a", "acceleration")}
    return with_torques(task, replace(trajectory, times=trajectory.times / rate, f=f, **rates, **accelerations))
