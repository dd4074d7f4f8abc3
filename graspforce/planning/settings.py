"""Settings that all planners share."""

from __future__ import annotations

from dataclasses import dataclass

from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput

DEFAULT_TOLERANCE = 1e-3
DEFAULT_BUDGET = 60.0  # s
PATH_INTERVALS, SEARCH_INTERVALS = 100, 40  # defaults along a path, and of a search for the path
_MAX_INTERVALS = 10_000
_TOLERANCES = (1e-9, 0.1)  # rounding errors of the check, and the largest excess that a plan may have


@dataclass(frozen=True, slots=True)
class PlanSettings:
    """Settings of a planner.

    Args:
        intervals: number of intervals between knots; None for the default, 100 along a given path and 40 otherwise.
        tolerance: largest excess of a limit between knots, relative to the limit, 1e-9 to 0.1.
        budget: time for planning, s. When it ends, the best plan so far is returned.
        compiled: True to compile the equations of a search to machine code, if there is a C compiler. The code is cached on
            disk; it makes searches faster, and the first one of a hand slower.

    Raises:
        InvalidInput: a value out of range.
    """

    intervals: int | None = None
    tolerance: float = DEFAULT_TOLERANCE
    budget: float = DEFAULT_BUDGET
    compiled: bool = False

    def __post_init__(self) -> None:
        if self.intervals is not None:
            fields.check_integer(self.intervals, "intervals", minimum=2, maximum=_MAX_INTERVALS)
        if not _TOLERANCES[0] <= arrays.check_number(self.tolerance, "tolerance") <= _TOLERANCES[1]:
            raise InvalidInput("tolerance", self.tolerance, f"from {_TOLERANCES[0]:g} to {_TOLERANCES[1]:g}")
        arrays.check_number(self.budget, "budget", minimum=0.0)
        fields.check_boolean(self.compiled, "compiled")
