"""PIQP: a proximal interior-point method for quadratic programs (Schwan, Jiang, Kuhn and Jones 2023)."""

from __future__ import annotations

from typing import Any

import numpy as np
import piqp

from graspforce.bench.entrant import TOLERANCE, Claim, Entry, Said, claim, lower_bounds
from graspforce.program import ConicProgram

PACKAGE = "piqp"
EXACT = False
WARM = False

_SAID = {piqp.PIQP_SOLVED: Said.SOLVED, piqp.PIQP_PRIMAL_INFEASIBLE: Said.INFEASIBLE}


def bind(program: ConicProgram, settings: str) -> Entry:
    """Its dense solver."""
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

    def read(answer: Any) -> Claim:
        status, result = answer
        said = _SAID.get(status, Said.GAVE_UP)
        return claim(program, said, result.x, -np.array(result.y), np.array(result.z_u), result.info.iter)

    return Entry(run, read)
