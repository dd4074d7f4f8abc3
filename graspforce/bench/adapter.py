"""Interface between the suite and a solver. An adapter is a module with these members:

    PACKAGE = "clarabel"   # distribution whose version the report states
    EXACT_CONES = True     # False: the solver gets pyramids only
    WARM_START = False     # whether the solver can start from an earlier solution
    FLOAT32 = True         # only for solvers that compute in single precision with the settings "float32"

    def bind(program: ConicProgram, settings: str) -> BoundSolver: ...

``settings`` is a key of `TOLERANCE`; a solver without tolerances ignores it. ``bind`` copies the problem into the solver's
arrays and is not timed. `BoundSolver.run` sets up and solves, and is timed. `BoundSolver.read` converts the output to a
`SolverResult`, which `judge` checks by the certificate.
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

# Requested accuracy by settings, for rows and costs of unit size; None keeps the solver's own default. With "float32" the
# numbers of the program have single precision, and only solvers that compute in single precision take part.
TOLERANCE = {"default": None, "high": 1e-10, "low": 1e-4, "float32": 1e-3}


class SolverStatus(str, Enum):
    """Status that a solver returns."""

    SOLVED = "solved"
    INFEASIBLE = "infeasible"
    NO_ANSWER = "no answer"


@dataclass(frozen=True, eq=False, slots=True)
class SolverResult:
    """Result of a solver, not yet judged.

    Args:
        status: status that the solver returned.
        f: (k,) stacked contact forces, N and N·m; None if not solved.
        multipliers: multipliers of the optimum or of the infeasibility certificate; None if the solver returned none.
        iterations: number of iterations that the solver reports; 0 if it reports none.
        row_error: largest violation of the rows that the solver got, see `relative_row_error`; None if it got no program.
    """

    status: SolverStatus
    f: Array | None
    multipliers: Multipliers | None
    iterations: int
    row_error: float | None = None


@dataclass(frozen=True, eq=False, slots=True)
class BoundSolver:
    """A solver with a problem in its own arrays.

    Args:
        run: timed solve. Its argument is the output of `run` for the previous problem (warm start), or None (cold).
        read: conversion of the output of `run` to a result; not timed.
    """

    run: Callable[[Any], Any]
    read: Callable[[Any], SolverResult]


class SolverAdapter(Protocol):
    """Members of an adapter module."""

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
        iterations: number of iterations that the solver reports.
    """
    parts = [None if part is None else np.array(part, dtype=np.float64).ravel() for part in (x, y, z)]
    x, y, z = (part if part is not None and np.isfinite(part).all() else None for part in parts)
    f, row_error = None, None
    if x is not None and status is SolverStatus.SOLVED:
        f, row_error = program.forces(x), relative_row_error(program, x)
    multipliers = None
    if y is not None and z is not None and program.problem.uncertainty is None:  # the certificate is that of one problem
        multipliers = program.multipliers(y, np.maximum(z, 0.0))
    return SolverResult(status, f, multipliers, int(iterations), row_error)


def relative_row_error(program: ConicProgram, x: Array) -> float:
    """Return the largest violation of A x = b, C x ≤ d and r − S x in the cones, as solvers measure it.

        violation / (1 + largest number of A x, b, C x, d, S x and r)

    Args:
        program: the program in the units that the solver got.
        x: (m,) its solution.
    """
    with np.errstate(all="ignore"):  # a diverged solver returns numbers that overflow
        products = [program.A @ x, program.C @ x, program.S @ x]
        slack, start = program.r - products[2], 0
        violations = [np.abs(products[0] - program.b), np.maximum(products[1] - program.d, 0.0)]
        for size in program.cones:
            part = slack[start : start + size]
            violations.append(np.maximum(np.linalg.norm(part[1:]) - part[:1], 0.0))
            start += size
        largest = max(
            (float(np.abs(part).max()) for part in (*products, program.b, program.d, program.r) if len(part)), default=0.0
        )
        error = max((float(part.max()) for part in violations if len(part)), default=0.0) / (1.0 + largest)
    return error if np.isfinite(error) else float(np.finfo(float).max)


def lower_bounds(program: ConicProgram) -> Array:
    """Return the lower bounds of C x, (i,), all minus infinity, for solvers with two-sided rows."""
    return np.full(len(program.d), -np.inf)
