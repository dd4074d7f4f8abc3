"""OSQP: a first-order splitting method for quadratic programs (Stellato, Banjac, Goulart, Bemporad and Boyd 2020)."""

from __future__ import annotations

from typing import Any

import numpy as np
import osqp
from scipy import sparse

from graspforce.bench.entrant import TOLERANCE, Claim, Entry, Said, claim, lower_bounds
from graspforce.program import ConicProgram

PACKAGE = "osqp"
EXACT = False
WARM = True

_SAID = {"solved": Said.SOLVED, "primal infeasible": Said.INFEASIBLE}
_MOST_STEPS = 1_000_000  # the accuracy asked for, or the suite's own limit of time, should end it


def bind(program: ConicProgram, settings: str) -> Entry:
    """Its own sparse arrays."""
    e = len(program.b)
    P = sparse.csc_matrix(np.triu(program.P))
    rows = sparse.csc_matrix(np.vstack([program.A, program.C]))
    lower = np.concatenate([program.b, lower_bounds(program)])
    upper = np.concatenate([program.b, program.d])
    tolerance = TOLERANCE[settings]
    options = {} if tolerance is None else {"eps_abs": tolerance, "eps_rel": tolerance, "max_iter": _MOST_STEPS}

    def run(start: Any) -> Any:
        solver = osqp.OSQP()
        solver.setup(P, program.q, rows, lower, upper, verbose=False, **options)
        if start is not None:
            solver.warm_start(x=start.x, y=start.y)
        return solver.solve(raise_error=False)

    def read(answer: Any) -> Claim:
        said = _SAID.get(answer.info.status, Said.GAVE_UP)
        prices = answer.prim_inf_cert if said is Said.INFEASIBLE else answer.y
        y, z = (None, None) if prices is None else (-np.array(prices[:e]), np.array(prices[e:]))
        return claim(program, said, answer.x, y, z, answer.info.iter)

    return Entry(run, read)
