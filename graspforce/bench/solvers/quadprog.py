"""quadprog: the dual active-set method of Goldfarb and Idnani (1983). It needs a definite cost, and gets a ridge for it."""

from __future__ import annotations

from typing import Any

import numpy as np
import quadprog

from graspforce.bench.entrant import Claim, Entry, Said, claim
from graspforce.program import ConicProgram

PACKAGE = "quadprog"
EXACT = False
WARM = False

_RIDGE = 1e-10  # of the largest entry of P, or of 1 where P is zero


def bind(program: ConicProgram, settings: str) -> Entry:
    """Columns of constraints, equalities first."""
    e = len(program.b)
    size = float(np.abs(program.P).max()) or 1.0
    P = program.P + _RIDGE * size * np.eye(len(program.q))
    columns = np.ascontiguousarray(np.vstack([program.A, -program.C]).T)
    right = np.concatenate([program.b, -program.d])

    def run(start: Any) -> Any:
        try:
            return quadprog.solve_qp(P, -program.q, columns, right, e)
        except ValueError as error:
            return str(error)

    def read(answer: Any) -> Claim:
        if isinstance(answer, str):
            said = Said.INFEASIBLE if "inconsistent" in answer else Said.GAVE_UP
            return Claim(said, None, None, 0)
        return claim(program, Said.SOLVED, answer[0], answer[4][:e], answer[4][e:], answer[3][0])

    return Entry(run, read)
