"""QOCO: an interior-point method for second-order cones with a quadratic cost (Chari and Açıkmeşe 2025)."""

from __future__ import annotations

from typing import Any

import numpy as np
import qoco
from scipy import sparse

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, make_result
from graspforce.force.cone_program import ConicProgram

PACKAGE = "qoco"
EXACT_CONES = True
WARM_START = False

_STATUS = {
    "QOCO_SOLVED": SolverStatus.SOLVED,
    "QOCO_SOLVED_INACCURATE": SolverStatus.SOLVED,
}  # no status for infeasible problems


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind QOCO with sparse matrices.

    Args:
        program: program to solve.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    m, e, i, cones = len(program.q), len(program.b), len(program.d), program.cones
    P = sparse.csc_matrix(program.P)
    A, G = sparse.csc_matrix(program.A), sparse.csc_matrix(np.vstack([program.C, program.S]))
    h = np.concatenate([program.d, program.r])
    sizes = np.array(cones, dtype=np.int32)
    tolerance = TOLERANCE[settings]
    options = {} if tolerance is None else {"abstol": tolerance, "reltol": tolerance}

    def run(start: Any) -> Any:
        solver = qoco.QOCO()
        solver.setup(m, len(h), e, P, program.q, A, program.b, G, h, i, len(cones), sizes, verbose=0, **options)
        return solver.solve()

    def read(output: Any) -> SolverResult:
        status = _STATUS.get(output.status, SolverStatus.NO_ANSWER)
        return make_result(program, status, output.x, -np.asarray(output.y), np.asarray(output.z)[:i], output.iters)

    return BoundSolver(run, read)
