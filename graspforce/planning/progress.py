"""How far planning is, and whether it goes on: the budget, whoever watches, and the best checked plan so far."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from graspforce.core import arrays
from graspforce.planning.failure import STOPPED, PlanFailure
from graspforce.planning.nlp.optimisers import OptimiserIteration
from graspforce.planning.plan import Plan

DEFAULT_BUDGET = 60.0  # s

JOINT_PATH = "reach"  # the fingers' joints along the path
PATH = "path"  # the fastest motion along it
EQUATIONS = "equations"  # of the whole move, as the solver takes them
SEARCH = "search"  # for a faster way
CHECK = "check"  # of what was found, between its knots
STAGES = (JOINT_PATH, PATH, EQUATIONS, SEARCH, CHECK)

STRAIGHT_PATH_SHARE = 0.1  # of the work of a search: what the straight path takes, where it begins, about
SEARCH_SHARE = (0.3, 0.9)  # likewise, from where to where the search goes
_HALFWAY_ITERATIONS = 20  # iterations after which it counts as half done


@dataclass(frozen=True, eq=False, slots=True)
class Progress:
    """How far planning is.

    Args:
        stage: what begins, or goes on: one of `STAGES`.
        fraction: of the whole work, 0 to 1; about, for nobody knows how long a search takes. It never falls.
        iteration: of the search; 0 in other stages.
        best: the duration of the best checked plan so far, s; None before the first.
        seconds: since planning began.
        plan: the best checked plan itself; None before the first, and where it is elsewhere.
    """

    stage: str
    fraction: float
    iteration: int
    best: float | None
    seconds: float
    plan: Plan | None = None


ProgressCallback = Callable[[Progress], bool | None]
"""Called with the progress at every stage and at every iteration of a search; returns False to stop, and nothing to go on."""


def should_continue(answer: bool | None) -> bool:
    """What a watch has said."""
    return answer is None or bool(answer)


class PlanningBudget:
    """A search under way. Stages ask it whether to go on; once told to stop, it says so for good.

    Attributes:
        best: the best checked plan so far.
        stopped: whether the budget ended, or whoever watches said stop.

    Args:
        budget: s from now.
        watch: told how far it is.

    Raises:
        InvalidInput: a budget that is negative or no number.
    """

    def __init__(self, budget: float, callback: ProgressCallback | None) -> None:
        self._budget = arrays.check_number(budget, "budget", minimum=0.0)
        self._started = time.perf_counter()
        self._callback, self._fraction = callback, 0.0
        self._stopped_by_callback = self.stopped = False
        self.best: Plan | None = None

    @property
    def remaining(self) -> float:
        """What is left of the budget, s."""
        return max(self._budget - (time.perf_counter() - self._started), 0.0)

    def should_continue(self, stage: str, fraction: float, iteration: int = 0) -> bool:
        """Say how far it is; returns whether to go on."""
        if not self.stopped:
            self._fraction = max(self._fraction, fraction)
            best = None if self.best is None else self.best.duration
            now = Progress(stage, self._fraction, iteration, best, time.perf_counter() - self._started, self.best)
            self._stopped_by_callback = self._callback is not None and not should_continue(self._callback(now))
            self.stopped = self._stopped_by_callback or self.remaining <= 0.0
        return not self.stopped

    def sub_callback(self, first: float, last: float) -> ProgressCallback:
        """What watches a planner whose work is a part of this one; whether its plan is one here is not for it to say."""

        def callback(now: Progress) -> bool:
            return now.stage == CHECK or self.should_continue(now.stage, first + (last - first) * now.fraction, now.iteration)

        return callback

    def solver_callback(self) -> Callable[[OptimiserIteration], bool]:
        """What watches a solver."""
        first, last = SEARCH_SHARE
        return lambda now: self.should_continue(
            SEARCH, first + (last - first) * now.number / (now.number + _HALFWAY_ITERATIONS), now.number
        )

    def add_plan(self, plan: Plan) -> None:
        """A checked plan; the faster one stays."""
        if self.best is None or plan.duration < self.best.duration:
            self.best = plan

    def result(self, otherwise: PlanFailure) -> Plan | PlanFailure:
        """The best plan; where there is none, that it was stopped, or otherwise why."""
        if self.best is not None:
            return replace(self.best, stopped=self.stopped)
        return self.failure() if self.stopped else otherwise

    def failure(self) -> PlanFailure:
        """That planning was stopped before there was a plan."""
        ended = "Planning was stopped" if self._stopped_by_callback else f"The budget of {self._budget:g} s ended"
        return PlanFailure(STOPPED, f"{ended} before there was a first plan.")
