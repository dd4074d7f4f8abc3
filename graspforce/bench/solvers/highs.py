"""HiGHS: simplex for linear programs, an active-set method for quadratic ones (Huangfu and Hall 2018)."""

from __future__ import annotations

from typing import Any

import highspy
import numpy as np
from scipy import sparse

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, lower_bounds, make_result
from graspforce.force.cone_program import ConicProgram

PACKAGE = "highspy"
EXACT_CONES = False
WARM_START = False

_MIN_TOLERANCE = 1e-10  # smallest tolerance that HiGHS accepts
_STATUS = {
    highspy.HighsModelStatus.kOptimal: SolverStatus.SOLVED,
    highspy.HighsModelStatus.kInfeasible: SolverStatus.INFEASIBLE,
}


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind HiGHS with a sparse model.

    Args:
        program: program without second-order cones.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    e, m = len(program.b), len(program.q)
    hessian = sparse.csc_matrix(np.tril(program.P))
    rows = sparse.csc_matrix(np.vstack([program.A, program.C]))
    model = highspy.HighsModel()
    if hessian.nnz:
        model.hessian_.dim_ = m
        model.hessian_.start_, model.hessian_.index_, model.hessian_.value_ = hessian.indptr, hessian.indices, hessian.data
    lp = model.lp_
    lp.num_col_, lp.num_row_, lp.col_cost_ = m, rows.shape[0], program.q
    lp.col_lower_, lp.col_upper_ = np.full(m, -highspy.kHighsInf), np.full(m, highspy.kHighsInf)
    lp.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    lp.a_matrix_.start_, lp.a_matrix_.index_, lp.a_matrix_.value_ = rows.indptr, rows.indices, rows.data
    lp.a_matrix_.num_row_, lp.a_matrix_.num_col_ = rows.shape
    lp.row_lower_ = np.concatenate([program.b, lower_bounds(program)])
    lp.row_upper_ = np.concatenate([program.b, program.d])
    tolerance = TOLERANCE[settings]
    make: Any = highspy.Highs  # the constructor is not typed

    def run(start: Any) -> Any:
        solver: Any = make()
        solver.setOptionValue("output_flag", False)
        solver.setOptionValue("threads", 1)
        if tolerance is not None:
            for name in ("primal_feasibility_tolerance", "dual_feasibility_tolerance"):
                solver.setOptionValue(name, max(tolerance, _MIN_TOLERANCE))
        if settings == "high":
            solver.setOptionValue("qp_regularization_value", 0.0)  # the default, 1e-7, shifts the optimum by as much
        solver.passModel(model)
        solver.run()
        return solver

    def read(solver: Any) -> SolverResult:
        status, solution = _STATUS.get(solver.getModelStatus(), SolverStatus.NO_ANSWER), solver.getSolution()
        duals = np.array(solution.row_dual)
        if status is not SolverStatus.SOLVED or len(duals) != rows.shape[0]:
            return SolverResult(status, None, None, 0)
        info = solver.getInfo()
        steps = max(info.qp_iteration_count, 0) + max(info.simplex_iteration_count, 0)
        return make_result(program, status, solution.col_value, duals[:e], -duals[e:], steps)

    return BoundSolver(run, read)
