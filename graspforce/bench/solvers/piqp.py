"""PIQP: a proximal interior-point method for quadratic programs (Schwan, Jiang, Kuhn and Jones 2023)."""

from __future__ import annotations

from typing import Any

import numpy as np
import piqp

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, lower_bounds, make_result
from graspforce.force.cone_program import ConicProgram

PACKAGE = "piqp"
EXACT_CONES = False
WARM_START = False

_STATUS = {piqp.PIQP_SOLVED: SolverStatus.SOLVED, piqp.PIQP_PRIMAL_INFEASIBLE: SolverStatus.INFEASIBLE}


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind the dense solver of PIQP.

    Requested tolerances are absolute, without a relative part: rows and costs of the programs have unit size, and the
    certificate measures absolute errors in these units.

    Args:
        program: program without second-order cones.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    P, A, C = (np.asfortranarray(part) for part in (program.P, program.A, program.C))
    lower = lower_bounds(program)
    tolerance = TOLERANCE[settings]

    def run(start: Any) -> Any:
        solver = piqp.DenseSolver()
        if tolerance is not None:
            solver.settings.eps_abs, solver.settings.eps_rel = tolerance, 0.0
            solver.settings.eps_duality_gap_abs, solver.settings.eps_duality_gap_rel = tolerance, 0.0
        solver.setup(P, program.q, A, program.b, C, lower, program.d)
        return solver.solve(), solver.result

    def read(output: Any) -> SolverResult:
        status, result = output
        status = _STATUS.get(status, SolverStatus.NO_ANSWER)
        return make_result(program, status, result.x, -np.array(result.y), np.array(result.z_u), result.info.iter)

    return BoundSolver(run, read)
