"""ProxQP: a proximal augmented-Lagrangian method for quadratic programs (Bambade et al. 2022)."""

from __future__ import annotations

from typing import Any

import numpy as np
from proxsuite import proxqp

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, make_result
from graspforce.force.cone_program import ConicProgram

PACKAGE = "proxsuite"
EXACT_CONES = False
WARM_START = True

_STATUS = {
    proxqp.QPSolverOutput.PROXQP_SOLVED: SolverStatus.SOLVED,
    proxqp.QPSolverOutput.PROXQP_PRIMAL_INFEASIBLE: SolverStatus.INFEASIBLE,
}
_NO_LIMIT = 1e20  # ProxQP's value for a missing bound


def bind(program: ConicProgram, settings: str, nearest: bool = False) -> BoundSolver:
    """Bind the dense solver of ProxQP; the sparse one is not faster at this size.

    Requested tolerances are absolute, as with PIQP.

    Args:
        program: program without second-order cones.
        settings: accuracy settings, a key of `TOLERANCE`.
        nearest: whether an infeasible problem is replaced by the nearest feasible one.
    """
    m, e, i = len(program.q), len(program.b), len(program.d)
    lower = np.full(i, -_NO_LIMIT)
    tolerance = TOLERANCE[settings]

    def run(start: Any) -> Any:
        qp = proxqp.dense.QP(m, e, i)
        qp.settings.primal_infeasibility_solving = nearest
        if tolerance is not None:
            qp.settings.eps_abs, qp.settings.eps_rel = tolerance, 0.0
        qp.init(program.P, program.q, program.A, program.b, program.C, lower, program.d)
        if start is None:
            qp.solve()
        else:
            qp.settings.initial_guess = proxqp.InitialGuess.WARM_START
            qp.solve(start.results.x, start.results.y, start.results.z)
        return qp

    def read(qp: Any) -> SolverResult:
        results = qp.results
        status = _STATUS.get(results.info.status, SolverStatus.NO_ANSWER)
        return make_result(program, status, results.x, -np.array(results.y), np.array(results.z), results.info.iter)

    return BoundSolver(run, read)
