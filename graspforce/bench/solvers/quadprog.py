"""quadprog: the dual active-set method of Goldfarb and Idnani (1983). It needs a definite cost, and gets a ridge for it."""

from __future__ import annotations

from typing import Any

import numpy as np
import quadprog

from graspforce.bench.adapter import BoundSolver, SolverResult, SolverStatus, make_result
from graspforce.force.cone_program import ConicProgram

PACKAGE = "quadprog"
EXACT_CONES = False
WARM_START = False

_RIDGE = 1e-10  # of the largest entry of P, or of 1 where P is zero


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Columns of constraints, equalities first."""
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

    def read(answer: Any) -> SolverResult:
        if isinstance(answer, str):
            status = SolverStatus.INFEASIBLE if "inconsistent" in answer else SolverStatus.NO_ANSWER
            return SolverResult(status, None, None, 0)
        return make_result(program, SolverStatus.SOLVED, answer[0], answer[4][:e], answer[4][e:], answer[3][0])

    return BoundSolver(run, read)
