"""What a solver is in the suite: a module with

    PACKAGE = "clarabel"                    # the distribution whose version the report states
    EXACT = True                            # whether it takes exact friction cones; else it gets pyramids alone
    WARM = False                            # whether it can start from an earlier answer

    def bind(program: ConicProgram, settings: str) -> Entry: ...

``settings`` is a name of `TOLERANCE`; a solver without tolerances does the same whatever it is. ``bind`` puts the problem into
the solver's own arrays, which is not timed; `BoundSolver.run` sets up and solves, which is; `BoundSolver.read` makes a claim
of what it
returned. A claim is only what the solver says: `judge` finds out what is true.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

import numpy as np

from graspforce.core.arrays import Array
from graspforce.force.cone_program import ConicProgram
from graspforce.force.multipliers import Multipliers

# What each setting asks of a solver, on rows and costs of unit size; "default" is what its authors chose.
TOLERANCE = {"default": None, "high": 1e-10, "low": 1e-4}


class SolverStatus(str, Enum):
    """Status that a solver returns."""

    SOLVED = "solved"
    INFEASIBLE = "infeasible"
    NO_ANSWER = "no answer"


@dataclass(frozen=True, eq=False, slots=True)
class SolverResult:
    """What a solver says.

    Args:
        said: of its own answer.
        f: (k,) stacked contact forces, N and N·m; None without an answer.
        multipliers: of the optimum, or of a proof that there is none; None where it gives none.
        iterations: its own count; 0 where it keeps none.
    """

    status: SolverStatus
    f: Array | None
    multipliers: Multipliers | None
    iterations: int


@dataclass(frozen=True, eq=False, slots=True)
class BoundSolver:
    """A solver with a problem in its arrays.

    Args:
        run: what is timed: from what `run` returned for the problem before, or from nothing (None).
        read: what the solver says, from what `run` returned.
    """

    run: Callable[[Any], Any]
    read: Callable[[Any], SolverResult]


class SolverAdapter(Protocol):
    """A solver's module."""

    PACKAGE: str
    EXACT_CONES: bool
    WARM_START: bool

    def bind(self, program: ConicProgram, settings: str) -> BoundSolver: ...


def make_result(program: ConicProgram, status: SolverStatus, x: Any, y: Any, z: Any, iterations: int) -> SolverResult:
    """Return the result of a solver from its numbers.

    Args:
        program: the solved program.
        status: status that the solver returned.
        x: (m,) solution, or None.
        y: (e,) multipliers of A x = b with P x + q = Aᵀ y − Cᵀ z + …; a ray if infeasible; None if missing.
        z: (i,) multipliers of C x ≤ d, ≥ 0; None if missing.
        iterations: number of iterations.
    """
    parts = [None if part is None else np.array(part, dtype=np.float64).ravel() for part in (x, y, z)]
    x, y, z = (part if part is not None and np.isfinite(part).all() else None for part in parts)
    f = program.forces(x) if x is not None and status is SolverStatus.SOLVED else None
    multipliers = program.multipliers(y, np.maximum(z, 0.0)) if y is not None and z is not None else None
    return SolverResult(status, f, multipliers, int(iterations))


def lower_bounds(program: ConicProgram) -> Array:
    """(i,) minus infinity, for solvers whose rows have two sides."""
    return np.full(len(program.d), -np.inf)
