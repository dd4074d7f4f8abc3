"""Solvers that reach Python through CasADi's `conic`. The function is built before the clock starts, the call is timed.

Its multipliers obey P x + q + [A; C]ᵀ λ = 0, positive where an upper bound holds.
"""

from __future__ import annotations

from typing import Any

import casadi
import numpy as np

from graspforce.bench.entrant import Claim, Entry, Said, claim, lower_bounds
from graspforce.program import ConicProgram


def bind(program: ConicProgram, plugin: str, options: dict[str, Any], infeasible: tuple[str, ...] = ()) -> Entry:
    """One of CasADi's solvers with a problem in its arrays.

    Args:
        program: without cones.
        plugin: its name in CasADi.
        options: for it.
        infeasible: its return statuses that claim so.
    """
    e = len(program.b)
    rows = np.vstack([program.A, program.C])
    dense = {"h": casadi.Sparsity.dense(*program.P.shape), "a": casadi.Sparsity.dense(*rows.shape)}
    solver = casadi.conic("solver", plugin, dense, {**options, "error_on_fail": False})
    lower, upper = np.concatenate([program.b, lower_bounds(program)]), np.concatenate([program.b, program.d])
    stated = {"h": program.P, "g": program.q, "a": rows, "lba": lower, "uba": upper}
    data = {name: casadi.DM(value) for name, value in stated.items()}

    def run(start: Any) -> Any:
        warm = {} if start is None else {"x0": start[0]["x"], "lam_a0": start[0]["lam_a"], "lam_x0": start[0]["lam_x"]}
        return solver(**data, **warm), solver.stats()

    def read(answer: Any) -> Claim:
        found, stats = answer
        said = Said.SOLVED if stats["success"] else Said.GAVE_UP
        if stats["return_status"] in infeasible or stats["unified_return_status"] == "SOLVER_RET_INFEASIBLE":
            said = Said.INFEASIBLE
        prices = np.array(found["lam_a"]).ravel()
        return claim(program, said, found["x"], -prices[:e], prices[e:], max(int(stats.get("iter_count", 0)), 0))

    return Entry(run, read)
