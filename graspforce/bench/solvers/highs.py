"""HiGHS: simplex for linear programs, an active-set method for quadratic ones (Huangfu and Hall 2018)."""

from __future__ import annotations

from typing import Any

import highspy
import numpy as np
from scipy import sparse

from graspforce.bench.entrant import TOLERANCE, Claim, Entry, Said, claim, lower_bounds
from graspforce.program import ConicProgram

PACKAGE = "highspy"
EXACT = False
WARM = False

_FINEST = 1e-10  # it takes no smaller tolerance
_SAID = {highspy.HighsModelStatus.kOptimal: Said.SOLVED, highspy.HighsModelStatus.kInfeasible: Said.INFEASIBLE}


def bind(program: ConicProgram, settings: str) -> Entry:
    """Its own model."""
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
    make: Any = highspy.Highs  # its constructor has no types

    def run(start: Any) -> Any:
        solver: Any = make()
        solver.setOptionValue("output_flag", False)
        solver.setOptionValue("threads", 1)
        if tolerance is not None:
            for name in ("primal_feasibility_tolerance", "dual_feasibility_tolerance"):
                solver.setOptionValue(name, max(tolerance, _FINEST))
        if settings == "high":
            solver.setOptionValue("qp_regularization_value", 0.0)  # its default, 1e-7, moves the optimum by as much
        solver.passModel(model)
        solver.run()
        return solver

    def read(solver: Any) -> Claim:
        said, found = _SAID.get(solver.getModelStatus(), Said.GAVE_UP), solver.getSolution()
        prices = np.array(found.row_dual)
        if said is not Said.SOLVED or len(prices) != rows.shape[0]:
            return Claim(said, None, None, 0)
        info = solver.getInfo()
        steps = max(info.qp_iteration_count, 0) + max(info.simplex_iteration_count, 0)
        return claim(program, said, found.col_value, prices[:e], -prices[e:], steps)

    return Entry(run, read)
