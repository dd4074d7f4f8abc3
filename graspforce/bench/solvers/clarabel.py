"""Clarabel: an interior-point method for exact cones and pyramids (Goulart and Chen 2024)."""

from __future__ import annotations

from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, make_result
from graspforce.force.cone_program import ConicProgram

PACKAGE = "clarabel"
EXACT_CONES = True
WARM_START = False

_STATUS = {"Solved": SolverStatus.SOLVED, "AlmostSolved": SolverStatus.SOLVED, "PrimalInfeasible": SolverStatus.INFEASIBLE}
_STATUS["AlmostPrimalInfeasible"] = SolverStatus.INFEASIBLE


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind Clarabel with sparse matrices.

    Args:
        program: program to solve.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    P = sparse.csc_matrix(np.triu(program.P))
    rows = sparse.csc_matrix(np.vstack([program.A, program.C, program.S]))
    right = np.concatenate([program.b, program.d, program.r])
    e, i = len(program.b), len(program.d)
    cones = [clarabel.ZeroConeT(e), *([clarabel.NonnegativeConeT(i)] if i else [])]
    cones += [clarabel.SecondOrderConeT(size) for size in program.cones]
    options = clarabel.DefaultSettings()
    options.verbose, options.max_threads = False, 1
    tolerance = TOLERANCE[settings]
    if tolerance is not None:
        options.tol_gap_abs = options.tol_gap_rel = options.tol_feas = tolerance

    def run(start: Any) -> Any:
        return clarabel.DefaultSolver(P, program.q, rows, right, cones, options).solve()

    def read(output: Any) -> SolverResult:
        dual = np.array(output.z)
        status = _STATUS.get(str(output.status), SolverStatus.NO_ANSWER)
        return make_result(program, status, output.x, -dual[:e], dual[e : e + i], output.iterations)

    return BoundSolver(run, read)
