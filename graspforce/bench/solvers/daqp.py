"""DAQP: a dual active-set method for small quadratic programs (Arnström, Bemporad and Axehill 2022)."""

from __future__ import annotations

from typing import Any

import daqp
import numpy as np

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, lower_bounds, make_result
from graspforce.force.cone_program import ConicProgram

PACKAGE = "daqp"
EXACT_CONES = False
WARM_START = True

_EQUALITY = 5  # DAQP's code for an equality row
_AUTOMATIC = -1.0  # regularise only a singular cost
_INFEASIBLE = -1  # exit flag


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind DAQP with dense rows, equalities first.

    Args:
        program: program without second-order cones.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    e, i = len(program.b), len(program.d)
    rows = np.ascontiguousarray(np.vstack([program.A, program.C]))
    upper = np.concatenate([program.b, program.d])
    lower = np.concatenate([program.b, lower_bounds(program)])
    sense = np.array([_EQUALITY] * e + [0] * i, dtype=np.intc)
    P = np.ascontiguousarray(program.P)
    tolerance = TOLERANCE[settings]
    options: dict[str, Any] = {} if tolerance is None else {"primal_tol": tolerance, "dual_tol": tolerance}

    def run(start: Any) -> Any:
        warm = {} if start is None else {"primal_start": start[0], "dual_start": start[3]["lam"]}
        return daqp.solve(P, program.q, rows, upper, lower, sense, eps_prox=_AUTOMATIC, **options, **warm)

    def read(output: Any) -> SolverResult:
        x, _, flag, info = output
        if flag <= 0:  # DAQP then leaves its multipliers uninitialised
            return SolverResult(
                SolverStatus.INFEASIBLE if flag == _INFEASIBLE else SolverStatus.NO_ANSWER, None, None, info["iterations"]
            )
        duals = np.array(info["lam"])
        return make_result(program, SolverStatus.SOLVED, x, -duals[:e], duals[e:], info["iterations"])

    return BoundSolver(run, read)
