"""Clarabel: an interior-point method for exact cones and pyramids (Goulart and Chen 2024)."""

from __future__ import annotations

import time
from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from graspforce.core.arrays import Array
from graspforce.force.cone_program import ConicProgram, conic_program
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution, Status, uncertified_solution

# Its tolerances are on scaled rows; the certificate asks for 1e-8 in units that can be a hundred times finer.
_TOLERANCE = 1e-10
_SOLVED = ("Solved", "AlmostSolved")
_INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")


@dataclass(frozen=True, eq=False, slots=True)
class ConicResult:
    """What Clarabel says of a cone program: x, and multipliers y of A x = b and z ≥ 0 of C x ≤ d; a ray where infeasible.

    ``converged``: Clarabel calls it solved, or almost so; otherwise its finite numbers are merely the last ones.
    """

    status: Status
    converged: bool
    x: Array
    y: Array
    z: Array
    iterations: int


def solve(problem: ForceProblem, previous: Solution | None = None) -> Solution:
    """The answer by Clarabel, on exact cones and on pyramids.

    Args:
        problem: any force problem.
        previous: not used: an interior-point method of this kind gains nothing from a warm start.
    """
    start = time.perf_counter()
    program = conic_program(problem)
    answer = solve_program(program)
    found = answer.status is Status.OPTIMAL
    return uncertified_solution(
        problem,
        answer.status,
        program.forces(answer.x) if found else None,
        None if answer.status is Status.FAILED else program.multipliers(answer.y, answer.z),
        backend="clarabel",
        iterations=answer.iterations,
        seconds=time.perf_counter() - start,
    )


def solve_program(program: ConicProgram) -> ConicResult:
    """A cone program's answer; whatever Clarabel's own status, finite numbers are handed on for others to judge."""
    rows = sparse.csc_matrix(np.vstack([program.A, program.C, program.S]))
    right = np.concatenate([program.b, program.d, program.r])
    e, i = len(program.b), len(program.d)
    upper = sparse.csc_matrix(np.triu(program.P))
    raw = solve_sparse(upper, program.q, rows, right, ConeSizes(e, i, program.cones), _TOLERANCE)
    return ConicResult(raw.status, raw.converged, raw.x, -raw.z[:e], np.maximum(raw.z[e : e + i], 0.0), raw.iterations)


@dataclass(frozen=True, slots=True)
class ConeSizes:
    """What the rows' slacks are held to, in this order: zero, not negative, second-order cones of the given dimensions."""

    zero: int
    nonnegative: int
    second_order: tuple[int, ...]


@dataclass(frozen=True, eq=False, slots=True)
class SparseConicResult:
    """What Clarabel says of sparse rows: x, and the multipliers z of all rows, z in the dual of their cones."""

    status: Status
    converged: bool
    x: Array
    z: Array
    iterations: int


def solve_sparse(
    P: sparse.csc_matrix,
    q: Array,
    A: sparse.csc_matrix,
    b: Array,
    cones: ConeSizes,
    tolerance: float,
    refine: bool = True,
    seconds: float = np.inf,
) -> SparseConicResult:
    """min ½ xᵀP x + qᵀx subject to b − A x in the cones, rows in the cones' order.

    Args:
        P: (m, m) the upper triangle of the cost's Hessian.
        q: (m,) its gradient at zero.
        A: (r, m) rows.
        b: (r,) their right sides.
        cones: what b − A x is held to.
        tolerance: of gap and residuals, relative.
        refine: whether each linear solve is refined iteratively, which well scaled rows do without in half the time.
        seconds: after which Clarabel gives up.
    """
    cone_types = [clarabel.ZeroConeT(cones.zero)]
    if cones.nonnegative:
        cone_types.append(clarabel.NonnegativeConeT(cones.nonnegative))
    cone_types += [clarabel.SecondOrderConeT(size) for size in cones.second_order]
    settings = _settings(tolerance)
    settings.iterative_refinement_enable = refine
    settings.time_limit = seconds
    answer = clarabel.DefaultSolver(P, q, A, b, cone_types, settings).solve()
    x, z = np.array(answer.x), np.array(answer.z)
    status = Status.OPTIMAL if np.isfinite(x).all() else Status.FAILED
    if str(answer.status) in _INFEASIBLE:
        status = Status.INFEASIBLE
    if not np.isfinite(z).all():
        status = Status.FAILED
    return SparseConicResult(status, str(answer.status) in _SOLVED, x, z, int(answer.iterations))


def _settings(tolerance: float) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    settings.max_threads = 1  # problems of this size gain nothing from more
    return settings
