"""SCS: a first-order splitting method for cones with a quadratic cost (O'Donoghue 2021)."""

from __future__ import annotations

from typing import Any

import numpy as np
import scs
from scipy import sparse

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, make_result
from graspforce.force.cone_program import ConicProgram

PACKAGE = "scs"
EXACT_CONES = True
WARM_START = True

_STATUS = {"solved": SolverStatus.SOLVED, "infeasible": SolverStatus.INFEASIBLE}  # first word; "(inaccurate …)" may follow
_MAX_ITERATIONS = 1_000_000  # high enough that the tolerance or the time limit ends the run


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind SCS with sparse matrices.

    Args:
        program: program to solve.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    e, i = len(program.b), len(program.d)
    data = {
        "P": sparse.csc_matrix(np.triu(program.P)),
        "c": program.q,
        "A": sparse.csc_matrix(np.vstack([program.A, program.C, program.S])),
        "b": np.concatenate([program.b, program.d, program.r]),
    }
    cone = {"z": e, "l": i, "q": list(program.cones)}
    tolerance = TOLERANCE[settings]
    options = {} if tolerance is None else {"eps_abs": tolerance, "eps_rel": tolerance, "max_iters": _MAX_ITERATIONS}

    def run(start: Any) -> Any:
        solver = scs.SCS(data, cone, verbose=False, **options)
        if start is None:
            return solver.solve()
        return solver.solve(warm_start=True, x=start["x"], y=start["y"], s=start["s"])

    def read(output: Any) -> SolverResult:
        status = _STATUS.get(output["info"]["status"].split()[0], SolverStatus.NO_ANSWER)
        return make_result(program, status, output["x"], -output["y"][:e], output["y"][e : e + i], output["info"]["iter"])

    return BoundSolver(run, read)
