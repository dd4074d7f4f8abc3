"""How far planning is, and whether it goes on: the budget, whoever watches, and the best checked plan so far."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from graspforce import arrays
from graspforce.planning.optimisers import Iteration
from graspforce.planning.plan import Plan
from graspforce.planning.refusal import STOPPED, Refusal

BUDGET = 60.0  # s

REACH = "reach"  # the fingers' joints along the path
PATH = "path"  # the fastest motion along it
EQUATIONS = "equations"  # of the whole move, as the solver takes them
SEARCH = "search"  # for a faster way
CHECK = "check"  # of what was found, between its knots
STAGES = (REACH, PATH, EQUATIONS, SEARCH, CHECK)

STRAIGHT = 0.1  # of the work of a search: what the straight path takes, where it begins, about
SEARCHING = (0.3, 0.9)  # likewise, from where to where the search goes
_HALF = 20  # iterations after which it counts as half done


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


Watch = Callable[[Progress], bool | None]
"""Called with the progress at every stage and at every iteration of a search; returns False to stop, and nothing to go on."""


def goes_on(said: bool | None) -> bool:
    """What a watch has said."""
    return said is None or bool(said)


class Course:
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

    def __init__(self, budget: float, watch: Watch | None) -> None:
        self._budget = arrays.number(budget, "budget", minimum=0.0)
        self._begun = time.perf_counter()
        self._watch, self._fraction = watch, 0.0
        self._told = self.stopped = False
        self.best: Plan | None = None

    @property
    def left(self) -> float:
        """What is left of the budget, s."""
        return max(self._budget - (time.perf_counter() - self._begun), 0.0)

    def goes_on(self, stage: str, fraction: float, iteration: int = 0) -> bool:
        """Say how far it is; returns whether to go on."""
        if not self.stopped:
            self._fraction = max(self._fraction, fraction)
            best = None if self.best is None else self.best.duration
            now = Progress(stage, self._fraction, iteration, best, time.perf_counter() - self._begun, self.best)
            self._told = self._watch is not None and not goes_on(self._watch(now))
            self.stopped = self._told or self.left <= 0.0
        return not self.stopped

    def part(self, first: float, last: float) -> Watch:
        """What watches a planner whose work is a part of this one; whether its plan is one here is not for it to say."""

        def watch(now: Progress) -> bool:
            return now.stage == CHECK or self.goes_on(now.stage, first + (last - first) * now.fraction, now.iteration)

        return watch

    def searching(self) -> Callable[[Iteration], bool]:
        """What watches a solver."""
        first, last = SEARCHING
        return lambda now: self.goes_on(SEARCH, first + (last - first) * now.number / (now.number + _HALF), now.number)

    def found(self, plan: Plan) -> None:
        """A checked plan; the faster one stays."""
        if self.best is None or plan.duration < self.best.duration:
            self.best = plan

    def outcome(self, otherwise: Refusal) -> Plan | Refusal:
        """The best plan; where there is none, that it was stopped, or otherwise why."""
        if self.best is not None:
            return replace(self.best, stopped=self.stopped)
        return self.refusal() if self.stopped else otherwise

    def refusal(self) -> Refusal:
        """That planning was stopped before there was a plan."""
        ended = "Planning was stopped" if self._told else f"The budget of {self._budget:g} s ended"
        return Refusal(STOPPED, f"{ended} before there was a first plan.")
