"""Progress of planning: its stages, the callback, the time budget, and the best checked plan so far."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from graspforce.core import arrays, fields
from graspforce.core.json_text import JsonRecord
from graspforce.planning.failure import STOPPED, PlanFailure
from graspforce.planning.nlp.iteration import OptimiserIteration
from graspforce.planning.plan import Plan

JOINT_PATH = "reach"  # the joints' path that follows the object's path
PATH = "path"  # the fastest motion along the path
EQUATIONS = "equations"  # the equations of the whole move, for the solver
SEARCH = "search"  # the search for a faster move
CHECK = "check"  # the check between the knots
STAGES = (JOINT_PATH, PATH, EQUATIONS, SEARCH, CHECK)

STRAIGHT_PATH_SHARE = 0.1  # of the work of a search: the plan along the straight path, approximately
SEARCH_SHARE = (0.3, 0.9)  # of the work: begin and end of the search itself
_RECORD_FIELDS = ("stage", "fraction", "iteration", "best", "seconds")
_HALFWAY_ITERATIONS = 20  # iterations after which a search counts as half done


@dataclass(frozen=True, eq=False, slots=True)
class Progress:
    """Progress of planning.

    Args:
        stage: the current stage, one of `STAGES`.
        fraction: estimated fraction of the whole work, 0 to 1; it never decreases.
        iteration: iteration of the search; 0 in other stages.
        best: duration of the best checked plan so far, s; None before the first.
        seconds: time since planning began.
        plan: the best checked plan so far; None before the first, and if the plan is made by a service.
    """

    stage: str
    fraction: float
    iteration: int
    best: float | None
    seconds: float
    plan: Plan | None = None

    @classmethod
    def from_dict(cls, record: object, field: str = "") -> Progress:
        """Return the progress of a record.

        Args:
            record: mapping that `to_dict` made.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=_RECORD_FIELDS)
        path, best = f"{field}." if field else "", values["best"]
        return cls(
            fields.check_choice(values["stage"], f"{path}stage", STAGES),
            arrays.check_number(values["fraction"], f"{path}fraction", minimum=0.0),
            fields.check_integer(values["iteration"], f"{path}iteration", minimum=0, maximum=2**31),
            None if best is None else arrays.check_number(best, f"{path}best", above=0.0),
            arrays.check_number(values["seconds"], f"{path}seconds", minimum=0.0),
        )

    def to_dict(self) -> JsonRecord:
        """Return the progress as a record for JSON, without the plan."""
        return {name: getattr(self, name) for name in _RECORD_FIELDS}


ProgressCallback = Callable[[Progress], bool | None]
"""Function called at every stage and at every iteration of a search. It returns False to stop; None and True continue."""


def should_continue(answer: bool | None) -> bool:
    """Return whether the return value of a progress callback lets planning continue.

    Args:
        answer: the return value.
    """
    return answer is None or bool(answer)


class PlanningBudget:
    """Time budget of a planner, which also holds the best checked plan so far.

    Attributes:
        best: the best checked plan so far.
        stopped: True once the budget has ended or the callback has returned False.

    Args:
        budget: time from now, s.
        callback: progress callback.

    Raises:
        InvalidInput: the budget is negative or not a number.
    """

    def __init__(self, budget: float, callback: ProgressCallback | None) -> None:
        self._budget = arrays.check_number(budget, "budget", minimum=0.0)
        self._started = time.perf_counter()
        self._callback, self._fraction = callback, 0.0
        self._stopped_by_callback = self.stopped = False
        self.best: Plan | None = None

    @property
    def remaining(self) -> float:
        """Return the remaining time, s."""
        return max(self._budget - (time.perf_counter() - self._started), 0.0)

    def should_continue(self, stage: str, fraction: float, iteration: int = 0) -> bool:
        """Report progress to the callback, and return whether planning continues.

        Args:
            stage: the current stage.
            fraction: estimated fraction of the whole work, 0 to 1.
            iteration: iteration of the search.
        """
        if not self.stopped:
            self._fraction = max(self._fraction, fraction)
            best = None if self.best is None else self.best.duration
            progress = Progress(stage, self._fraction, iteration, best, time.perf_counter() - self._started, self.best)
            self._stopped_by_callback = self._callback is not None and not should_continue(self._callback(progress))
            self.stopped = self._stopped_by_callback or self.remaining <= 0.0
        return not self.stopped

    def sub_callback(self, first: float, last: float) -> ProgressCallback:
        """Return a callback for another planner whose work is a part of this one; its plans are not reported.

        Args:
            first: fraction of the whole work at which that part begins.
            last: fraction at which it ends.
        """

        def callback(progress: Progress) -> bool:
            fraction = first + (last - first) * progress.fraction
            return progress.stage == CHECK or self.should_continue(progress.stage, fraction, progress.iteration)

        return callback

    def solver_callback(self) -> Callable[[OptimiserIteration], bool]:
        """Return a callback for a solver."""
        first, last = SEARCH_SHARE

        def callback(iteration: OptimiserIteration) -> bool:
            share = iteration.number / (iteration.number + _HALFWAY_ITERATIONS)
            return self.should_continue(SEARCH, first + (last - first) * share, iteration.number)

        return callback

    def add_plan(self, plan: Plan) -> None:
        """Keep a checked plan if it is faster than the best so far.

        Args:
            plan: the plan.
        """
        if self.best is None or plan.duration < self.best.duration:
            self.best = plan

    def result(self, otherwise: PlanFailure) -> Plan | PlanFailure:
        """Return the best plan; without one, the failure of a stopped search, or the given failure.

        Args:
            otherwise: the failure if there is no plan and planning was not stopped.
        """
        if self.best is not None:
            return replace(self.best, stopped=self.stopped)
        return self.failure() if self.stopped else otherwise

    def failure(self) -> PlanFailure:
        """Return the failure of planning that was stopped before the first plan."""
        return stopped_failure(None if self._stopped_by_callback else self._budget)


def stopped_failure(budget: float | None) -> PlanFailure:
    """Return the failure of planning that was stopped before the first plan.

    Args:
        budget: the budget that ended, s; None if the caller stopped it.
    """
    cause = "Planning was stopped" if budget is None else f"The budget of {budget:g} s ended"
    return PlanFailure(STOPPED, f"{cause} before there was a first plan.")
