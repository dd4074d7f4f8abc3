"""Moreau: an interior-point method for cones, on the processor or a GPU. It runs on one thread of the processor here."""

from __future__ import annotations

from typing import Any

import moreau
import numpy as np
from scipy import sparse

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, make_result
from graspforce.force.cone_program import ConicProgram

PACKAGE = "moreau"
EXACT_CONES = True
WARM_START = True

_STATUS = {"Solved": SolverStatus.SOLVED, "AlmostSolved": SolverStatus.SOLVED, "PrimalInfeasible": SolverStatus.INFEASIBLE}
_STATUS["AlmostPrimalInfeasible"] = SolverStatus.INFEASIBLE


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind Moreau with sparse matrices; it takes the whole of P.

    Args:
        program: program to solve.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    e, i = len(program.b), len(program.d)
    P = sparse.csr_array(program.P)
    rows = sparse.csr_array(np.vstack([program.A, program.C, program.S]))
    right = np.concatenate([program.b, program.d, program.r])
    cones = moreau.Cones(num_zero_cones=e, num_nonneg_cones=i, so_cone_dims=list(program.cones))
    tolerance = TOLERANCE[settings]
    tolerances = {} if tolerance is None else dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), tolerance)
    inner = moreau.IPMSettings(**tolerances)
    options = moreau.Settings(device="cpu", solver="ipm", ipm_settings=inner)

    def run(start: Any) -> Any:
        solver = moreau.Solver(P, program.q, rows, right, cones, options)
        same = start is not None and start[0].x.shape == program.q.shape and start[0].z.shape == right.shape
        return solver.solve(start[0].to_warm_start() if same else None), solver.info

    def read(output: Any) -> SolverResult:
        solution, info = output
        dual = np.array(solution.z)
        status = _STATUS.get(info.status.name, SolverStatus.NO_ANSWER)
        return make_result(program, status, solution.x, -dual[:e], dual[e : e + i], info.iterations)

    return BoundSolver(run, read)
