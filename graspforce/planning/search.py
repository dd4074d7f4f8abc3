"""The search for a faster move than the first guess: one solver after the other, and the check of their results."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from graspforce.core.arrays import Array
from graspforce.planning.check import check
from graspforce.planning.failure import PlanFailure
from graspforce.planning.nlp.layout import Program
from graspforce.planning.nlp.optimisers import MIN_SECONDS, OptimiserResult, optimise
from graspforce.planning.plan import Plan, PlanCheck, PlanningStatistics
from graspforce.planning.progress import CHECK, SEARCH, SEARCH_SHARE, PlanningBudget
from graspforce.planning.task import Task
from graspforce.planning.time_scaling import slow_down_to_limits
from graspforce.planning.trajectory import Trajectory


class MoveProgram(Protocol):
    """A move as a minimum-time program."""

    @property
    def task(self) -> Task:
        """Return the task."""

    @property
    def program(self) -> Program:
        """Return the program."""

    @property
    def guess(self) -> Array:
        """Return the first guess (K + 1, size)."""

    def trajectory(self, x: Array) -> Trajectory:
        """Return the states at the knots.

        Args:
            x: (K + 1, size) variables at each knot.
        """


def find_faster_plan(
    move: MoveProgram,
    budget: PlanningBudget,
    setup_seconds: float,
    tolerance: float,
    is_allowed: Callable[[Plan], bool],
    find_collision: Callable[[Plan], PlanFailure | None],
) -> PlanFailure | None:
    """Search for a plan, and add the first one that passes its check to the budget. It is slowed down if necessary.

    Args:
        move: the move.
        budget: the remaining time; it receives the plan.
        setup_seconds: time spent before the search, s, for the statistics.
        tolerance: largest excess of a limit between knots, relative to the limit.
        is_allowed: test of a plan for conditions outside its check; it runs before the check.
        find_collision: function that returns the collision of a plan, if it has one.

    Returns:
        The collision of the first result, if it has one: another solver would find the same motion. None otherwise.
    """
    for solver, min_seconds in MIN_SECONDS.items():
        if not budget.should_continue(SEARCH, SEARCH_SHARE[0]) or budget.remaining <= min_seconds:
            return None
        result = optimise(move.program, move.guess, solver, seconds=budget.remaining, callback=budget.solver_callback())
        if not (budget.should_continue(CHECK, SEARCH_SHARE[1]) or result.converged):
            return None  # the iterate of an interrupted search is rarely a plan, and its check takes long
        plan = _checked_plan(move, result, setup_seconds, tolerance, is_allowed)
        if plan is not None:
            collision = find_collision(plan)
            if collision is None:
                budget.add_plan(plan)
            return collision
    return None


def _checked_plan(
    move: MoveProgram, result: OptimiserResult, setup_seconds: float, tolerance: float, is_allowed: Callable[[Plan], bool]
) -> Plan | None:
    """Return the solver's result as a plan that passes its check, slowed down if necessary; None if there is none."""
    if not move.program.meets_end_values(result.x):
        return None
    started = time.perf_counter()
    statistics = PlanningStatistics(
        path=setup_seconds,
        dynamics=result.evaluating_seconds,
        building=result.building_seconds,
        solver=result.solving_seconds - result.evaluating_seconds,
        check=0.0,
        solves=1,
        iterations=result.iterations,
    )
    plan = Plan(move.task, move.trajectory(result.x), PlanCheck.not_made(tolerance), np.nan, statistics, np.zeros(0))
    if not is_allowed(plan):
        return None
    slowed = slow_down_to_limits(replace(plan, check=check(plan, tolerance)[0]), tolerance)
    if slowed is None:
        return None
    return replace(slowed, statistics=replace(statistics, check=time.perf_counter() - started))
