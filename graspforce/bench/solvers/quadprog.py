"""quadprog: the dual active-set method of Goldfarb and Idnani (1983). It needs a positive definite cost, hence a ridge."""

from __future__ import annotations

from typing import Any

import numpy as np
import quadprog

from graspforce.bench.adapter import BoundSolver, SolverResult, SolverStatus, make_result
from graspforce.force.cone_program import ConicProgram

PACKAGE = "quadprog"
EXACT_CONES = False
WARM_START = False

_RIDGE = 1e-10  # relative to the largest entry of P, or to 1 if P is zero


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind quadprog with constraints as columns, equalities first.

    Args:
        program: program without second-order cones.
        settings: ignored; quadprog has no tolerances.
    """
    e = len(program.b)
    size = float(np.abs(program.P).max()) or 1.0
    P = program.P + _RIDGE * size * np.eye(len(program.q))
    columns = np.ascontiguousarray(np.vstack([program.A, -program.C]).T)
    right = np.concatenate([program.b, -program.d])

    def run(start: Any) -> Any:
        try:
            return quadprog.solve_qp(P, -program.q, columns, right, e)
        except ValueError as error:
            return str(error)

    def read(output: Any) -> SolverResult:
        if isinstance(output, str):
            status = SolverStatus.INFEASIBLE if "inconsistent" in output else SolverStatus.NO_ANSWER
            return SolverResult(status, None, None, 0)
        return make_result(program, SolverStatus.SOLVED, output[0], output[4][:e], output[4][e:], output[3][0])

    return BoundSolver(run, read)
