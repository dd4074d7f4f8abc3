"""Clarabel: an interior-point method for second-order cones and pyramids (Goulart and Chen 2024)."""

from __future__ import annotations

import time
from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from graspforce.core.arrays import Array
from graspforce.force.backends.protocol import Backend, SimpleSession, SolverSettings
from graspforce.force.cone_program import ConicProgram, ConicResult, conic_program
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution, uncertified_solution
from graspforce.force.status import Status

_TOLERANCE = 1e-10  # on scaled rows; the certificate requires 1e-8 in units that can be a hundred times smaller
_SOLVED = ("Solved", "AlmostSolved")
_INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")


class ClarabelBackend:
    """Clarabel as a backend. It supports every force problem and has no warm start."""

    name = "clarabel"
    unavailable_reason = ""

    @np.errstate(all="ignore")  # a solution that overflows is not certified
    def solve(self, problem: ForceProblem, settings: SolverSettings, guess: Solution | None = None) -> Solution:
        """Return the solution of a problem, as `Backend.solve`."""
        start = time.perf_counter()
        program = conic_program(problem)
        result = _solve_program(program, settings)
        return uncertified_solution(
            problem,
            result.status,
            program.forces(result.x) if result.status is Status.OPTIMAL else None,
            None if result.status is Status.FAILED else program.multipliers(result.y, result.z),
            backend=self.name,
            iterations=result.iterations,
            seconds=time.perf_counter() - start,
        )

    def start_session(self, problem: ForceProblem, settings: SolverSettings) -> SimpleSession:
        """Return a session that solves every changed problem as a whole."""
        return SimpleSession(problem, lambda changed: self.solve(changed, settings))

    def solve_program(self, program: ConicProgram, time_limit: float | None = None) -> ConicResult:
        """Return the result of a cone program, at the backend's own tolerance, as `ConicBackend.solve_program`."""
        return _solve_program(program, SolverSettings(time_limit=time_limit))


BACKENDS: tuple[Backend, ...] = (ClarabelBackend(),)


def _solve_program(program: ConicProgram, settings: SolverSettings) -> ConicResult:
    """Return the result of a cone program; finite numbers count as optimal, whatever Clarabel's own status."""
    rows = sparse.csc_matrix(np.vstack([program.A, program.C, program.S]))
    right = np.concatenate([program.b, program.d, program.r])
    e, i = len(program.b), len(program.d)
    upper = sparse.csc_matrix(np.triu(program.P))
    raw = solve_sparse(upper, program.q, rows, right, ConeSizes(e, i, program.cones), settings)
    return ConicResult(raw.status, raw.converged, raw.x, -raw.z[:e], np.maximum(raw.z[e : e + i], 0.0), raw.iterations)


@dataclass(frozen=True, slots=True)
class ConeSizes:
    """The cones of the rows' slacks, in this order.

    Args:
        zero: number of slacks that must be zero.
        nonnegative: number of slacks that must be ≥ 0.
        second_order: dimension of each second-order cone.
    """

    zero: int
    nonnegative: int
    second_order: tuple[int, ...]


@dataclass(frozen=True, eq=False, slots=True)
class SparseConicResult:
    """Clarabel's result for a sparse program.

    Args:
        status: as in `ConicResult`.
        converged: Clarabel reports convergence.
        x: (m,) the variables.
        z: (r,) the multipliers of all rows, in the dual cones.
        iterations: Clarabel's iterations.
    """

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
    settings: SolverSettings,
    refine: bool = True,
) -> SparseConicResult:
    """Return the result of min ½ xᵀP x + qᵀx subject to b − A x in cones.

    Args:
        P: (m, m) upper triangle of the cost's Hessian.
        q: (m,) gradient of the cost at zero.
        A: (r, m) rows, in the order of the cones.
        b: (r,) right sides.
        cones: the cones of b − A x.
        settings: tolerance of the gap and of the residuals, relative; limits on iterations and time.
        refine: refine each linear solve iteratively; well scaled rows do not need it.
    """
    cone_types = [clarabel.ZeroConeT(cones.zero)]
    if cones.nonnegative:
        cone_types.append(clarabel.NonnegativeConeT(cones.nonnegative))
    cone_types += [clarabel.SecondOrderConeT(size) for size in cones.second_order]
    result = clarabel.DefaultSolver(P, q, A, b, cone_types, _clarabel_settings(settings, refine)).solve()
    x, z = np.array(result.x), np.array(result.z)
    status = Status.OPTIMAL if np.isfinite(x).all() else Status.FAILED
    if str(result.status) in _INFEASIBLE:
        status = Status.INFEASIBLE
    if not np.isfinite(z).all():
        status = Status.FAILED
    return SparseConicResult(status, str(result.status) in _SOLVED, x, z, int(result.iterations))


def _clarabel_settings(settings: SolverSettings, refine: bool) -> clarabel.DefaultSettings:
    """Return Clarabel's own settings."""
    own = clarabel.DefaultSettings()
    own.verbose = False
    own.max_threads = 1  # problems of this size gain nothing from more
    own.iterative_refinement_enable = refine
    own.tol_gap_abs = own.tol_gap_rel = own.tol_feas = settings.tolerance or _TOLERANCE
    if settings.max_iterations is not None:
        own.max_iter = settings.max_iterations
    if settings.time_limit is not None:
        own.time_limit = settings.time_limit
    return own
