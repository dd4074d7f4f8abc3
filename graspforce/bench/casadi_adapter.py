"""Solvers that reach Python through CasADi's `conic`. The function is built before the clock starts, the call is timed.

Some keep a factorisation and a working set from one call to the next. A cold run is therefore the first call of a function, and
a warm one calls the function that solved the problem before, where that has the same shape.

Its multipliers obey P x + q + [A; C]ᵀ λ = 0, positive where an upper bound holds.
"""

from __future__ import annotations

from typing import Any

import casadi
import numpy as np

from graspforce.bench.adapter import BoundSolver, SolverResult, SolverStatus, lower_bounds, make_result
from graspforce.force.cone_program import ConicProgram


def bind(program: ConicProgram, plugin: str, options: dict[str, Any], infeasible: tuple[str, ...] = ()) -> BoundSolver:
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
        if start is None or start[2].sparsity_in("a") != solver.sparsity_in("a"):
            return solver(**data), solver.stats(), solver
        found, _, before = start
        return before(**data, x0=found["x"], lam_a0=found["lam_a"], lam_x0=found["lam_x"]), before.stats(), before

    def read(answer: Any) -> SolverResult:
        found, stats, _ = answer
        status = SolverStatus.SOLVED if stats["success"] else SolverStatus.NO_ANSWER
        if stats["return_status"] in infeasible or stats["unified_return_status"] == "SOLVER_RET_INFEASIBLE":
            status = SolverStatus.INFEASIBLE
        duals = np.array(found["lam_a"]).ravel()
        return make_result(program, status, found["x"], -duals[:e], duals[e:], max(int(stats.get("iter_count", 0)), 0))

    return BoundSolver(run, read)
