"""SCS: a first-order splitting method for cones with a quadratic cost (O'Donoghue 2021)."""

from __future__ import annotations

from typing import Any

import numpy as np
import scs
from scipy import sparse

from graspforce.bench.entrant import TOLERANCE, Claim, Entry, Said, claim
from graspforce.program import ConicProgram

PACKAGE = "scs"
EXACT = True
WARM = True

_SAID = {"solved": Said.SOLVED, "infeasible": Said.INFEASIBLE}
_MOST_STEPS = 1_000_000  # the accuracy asked for, or the suite's own limit of time, should end it


def bind(program: ConicProgram, settings: str) -> Entry:
    """Its own sparse arrays."""
    e, i = len(program.b), len(program.d)
    data = {
        "P": sparse.csc_matrix(np.triu(program.P)),
        "c": program.q,
        "A": sparse.csc_matrix(np.vstack([program.A, program.C, program.S])),
        "b": np.concatenate([program.b, program.d, program.r]),
    }
    cone = {"z": e, "l": i, "q": list(program.cones)}
    tolerance = TOLERANCE[settings]
    options = {} if tolerance is None else {"eps_abs": tolerance, "eps_rel": tolerance, "max_iters": _MOST_STEPS}

    def run(start: Any) -> Any:
        solver = scs.SCS(data, cone, verbose=False, **options)
        if start is None:
            return solver.solve()
        return solver.solve(warm_start=True, x=start["x"], y=start["y"], s=start["s"])

    def read(answer: Any) -> Claim:
        said = _SAID.get(answer["info"]["status"], Said.GAVE_UP)
        return claim(program, said, answer["x"], -answer["y"][:e], answer["y"][e : e + i], answer["info"]["iter"])

    return Entry(run, read)
