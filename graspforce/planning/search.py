"""The search for a faster way than the first guess, by one solver after the other, and the check of what they say."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from graspforce.arrays import Array
from graspforce.planning.optimisers import LEAST_SECONDS, Answer, optimise
from graspforce.planning.plan import Check, Effort, Motion, Plan
from graspforce.planning.progress import CHECK, SEARCH, SEARCHING, Course
from graspforce.planning.slower import slowed_enough
from graspforce.planning.task import Task
from graspforce.planning.transcription import Program
from graspforce.planning.verify import check


class Move(Protocol):
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

    def motion(self, x: Array) -> Motion:
        """States at the knots from the program's variables."""


def search(move: Move, course: Course, begun: float, tolerance: float, allowed: Callable[[Plan], bool]) -> None:
    """Tell the course of the first plan that a solver finds and that passes its check, slowed where it must be.

    Args:
        move: what is searched.
        course: says how long, and is told what is found.
        begun: s that it took until here.
        tolerance: how much of each limit may be exceeded between knots.
        allowed: whether a plan keeps what the check does not look at; asked before the check.
    """
    for solver, least in LEAST_SECONDS.items():
        if not course.goes_on(SEARCH, SEARCHING[0]) or course.left <= least:
            return
        answer = optimise(move.program, move.guess, solver, seconds=course.left, watch=course.searching())
        if not (course.goes_on(CHECK, SEARCHING[1]) or answer.converged):
            return  # where a search was interrupted is hardly ever a plan, and to find out takes as long as ten iterations
        found = _checked(move, answer, begun, tolerance, allowed)
        if found is not None:
            course.found(found)
            return


def _checked(move: Move, answer: Answer, begun: float, tolerance: float, allowed: Callable[[Plan], bool]) -> Plan | None:
    """The answer as a plan that passes its check, slowed where it must be; None where it does not."""
    if not move.program.joins(answer.x):
        return None
    since = time.perf_counter()
    unchecked = Check(*(np.inf,) * 8, samples=0, tolerance=tolerance)
    effort = Effort(begun, answer.evaluating, answer.building, answer.solving - answer.evaluating, 0.0, 1, answer.iterations)
    plan = Plan(move.task, move.motion(answer.x), unchecked, np.nan, effort, np.zeros(0))
    if not allowed(plan):
        return None
    mended = slowed_enough(replace(plan, check=check(plan, tolerance)[0]), tolerance)
    if mended is None:
        return None
    return replace(mended, effort=replace(effort, check=time.perf_counter() - since))
