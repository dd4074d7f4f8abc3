"""The search for a faster way than the first guess, by one solver after the other, and the check of what they say."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from graspforce.core.arrays import Array
from graspforce.planning.check import check
from graspforce.planning.nlp.optimisers import MIN_SECONDS, OptimiserResult, optimise
from graspforce.planning.nlp.transcription import Program
from graspforce.planning.plan import Plan, PlanCheck, PlanningStatistics, Trajectory
from graspforce.planning.progress import CHECK, SEARCH, SEARCH_SHARE, PlanningBudget
from graspforce.planning.task import Task
from graspforce.planning.time_scaling import slow_down_to_limits


class MoveProgram(Protocol):
    """A move as a program, and what its variables mean."""

    @property
    def task(self) -> Task:
        """What moves."""

    @property
    def program(self) -> Program:
        """The program."""

    @property
    def guess(self) -> Array:
        """(K + 1, size) where its solution may begin."""

    def trajectory(self, x: Array) -> Trajectory:
        """States at the knots from the program's variables."""


def find_faster_plan(
    move: MoveProgram,
    planning_budget: PlanningBudget,
    setup_seconds: float,
    tolerance: float,
    is_allowed: Callable[[Plan], bool],
) -> None:
    """Tell the course of the first plan that a solver finds and that passes its check, slowed where it must be.

    Args:
        move: what is searched.
        course: says how long, and is told what is found.
        begun: s that it took until here.
        tolerance: how much of each limit may be exceeded between knots.
        allowed: whether a plan keeps what the check does not look at; asked before the check.
    """
    for solver, least in MIN_SECONDS.items():
        if not planning_budget.should_continue(SEARCH, SEARCH_SHARE[0]) or planning_budget.remaining <= least:
            return
        answer = optimise(
            move.program, move.guess, solver, seconds=planning_budget.remaining, callback=planning_budget.solver_callback()
        )
        if not (planning_budget.should_continue(CHECK, SEARCH_SHARE[1]) or answer.converged):
            return  # where a search was interrupted is hardly ever a plan, and to find out takes as long as ten iterations
        found = _checked(move, answer, setup_seconds, tolerance, is_allowed)
        if found is not None:
            planning_budget.add_plan(found)
            return


def _checked(
    move: MoveProgram, answer: OptimiserResult, setup_seconds: float, tolerance: float, is_allowed: Callable[[Plan], bool]
) -> Plan | None:
    """The answer as a plan that passes its check, slowed where it must be; None where it does not."""
    if not move.program.meets_end_values(answer.x):
        return None
    since = time.perf_counter()
    unchecked = PlanCheck(*(np.inf,) * 8, samples=0, tolerance=tolerance)
    statistics = PlanningStatistics(
        setup_seconds, answer.evaluating, answer.building, answer.solving - answer.evaluating, 0.0, 1, answer.iterations
    )
    plan = Plan(move.task, move.trajectory(answer.x), unchecked, np.nan, statistics, np.zeros(0))
    if not is_allowed(plan):
        return None
    mended = slow_down_to_limits(replace(plan, check=check(plan, tolerance)[0]), tolerance)
    if mended is None:
        return None
    return replace(mended, statistics=replace(statistics, check=time.perf_counter() - since))
