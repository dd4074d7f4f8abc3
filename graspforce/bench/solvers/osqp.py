"""OSQP: a first-order splitting method for quadratic programs (Stellato, Banjac, Goulart, Bemporad and Boyd 2020)."""

from __future__ import annotations

from typing import Any

import numpy as np
import osqp
from scipy import sparse

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, lower_bounds, make_result
from graspforce.force.cone_program import ConicProgram

PACKAGE = "osqp"
EXACT_CONES = False
WARM_START = True

_STATUS = {"solved": SolverStatus.SOLVED, "solved inaccurate": SolverStatus.SOLVED}
_STATUS |= dict.fromkeys(("primal infeasible", "primal infeasible inaccurate"), SolverStatus.INFEASIBLE)
_MAX_ITERATIONS = 1_000_000  # high enough that the tolerance or the time limit ends the run


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind OSQP with sparse matrices.

    Args:
        program: program without second-order cones.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    e = len(program.b)
    P = sparse.csc_matrix(np.triu(program.P))
    rows = sparse.csc_matrix(np.vstack([program.A, program.C]))
    lower = np.concatenate([program.b, lower_bounds(program)])
    upper = np.concatenate([program.b, program.d])
    tolerance = TOLERANCE[settings]
    options = {} if tolerance is None else {"eps_abs": tolerance, "eps_rel": tolerance, "max_iter": _MAX_ITERATIONS}

    def run(start: Any) -> Any:
        solver = osqp.OSQP()
        solver.setup(P, program.q, rows, lower, upper, verbose=False, **options)
        if start is not None:
            solver.warm_start(x=start.x, y=start.y)
        return solver.solve(raise_error=False)

    def read(output: Any) -> SolverResult:
        status = _STATUS.get(output.info.status, SolverStatus.NO_ANSWER)
        duals = output.prim_inf_cert if status is SolverStatus.INFEASIBLE else output.y
        y, z = (None, None) if duals is None else (-np.array(duals[:e]), np.array(duals[e:]))
        return make_result(program, status, output.x, y, z, output.info.iter)

    return BoundSolver(run, read)
