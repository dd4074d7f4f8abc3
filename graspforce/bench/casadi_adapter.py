"""Adapter for the solvers behind CasADi's `conic` and `nlpsol`. The function is built before timing; only its call is timed.

Some plugins keep a factorisation and a working set between calls. A cold run is therefore the first call of a new function. A
warm run calls the function that solved the previous problem, if that has the same shape.

CasADi's multipliers λ satisfy P x + q + [A; C]ᵀ λ = 0, with λ > 0 at active upper bounds.
"""

from __future__ import annotations

from typing import Any

import casadi
import numpy as np

from graspforce.bench.adapter import BoundSolver, SolverResult, SolverStatus, lower_bounds, make_result
from graspforce.bench.smooth_cones import cone_heads, cone_parts, interior_start
from graspforce.force.cone_program import ConicProgram


def bind(program: ConicProgram, plugin: str, options: dict[str, Any], infeasible: tuple[str, ...] = ()) -> BoundSolver:
    """Bind a problem to one of CasADi's plugins.

    Args:
        program: program without second-order cones.
        plugin: name of the plugin in CasADi.
        options: options of the plugin.
        infeasible: return statuses of the plugin that mean infeasible.
    """
    e = len(program.b)
    rows = np.vstack([program.A, program.C])
    dense = {"h": casadi.Sparsity.dense(*program.P.shape), "a": casadi.Sparsity.dense(*rows.shape)}
    solver = casadi.conic("solver", plugin, dense, {**options, "error_on_fail": False})
    lower, upper = np.concatenate([program.b, lower_bounds(program)]), np.concatenate([program.b, program.d])
    arguments = {"h": program.P, "g": program.q, "a": rows, "lba": lower, "uba": upper}
    data = {name: casadi.DM(value) for name, value in arguments.items()}

    def run(start: Any) -> Any:
        if start is None or start[2].sparsity_in("a") != solver.sparsity_in("a"):
            return solver(**data), solver.stats(), solver
        previous, _, same = start
        return same(**data, x0=previous["x"], lam_a0=previous["lam_a"], lam_x0=previous["lam_x"]), same.stats(), same

    def read(output: Any) -> SolverResult:
        solution, stats, _ = output
        status = SolverStatus.SOLVED if stats["success"] else SolverStatus.NO_ANSWER
        if stats["return_status"] in infeasible or stats["unified_return_status"] == "SOLVER_RET_INFEASIBLE":
            status = SolverStatus.INFEASIBLE
        duals = np.array(solution["lam_a"]).ravel()
        return make_result(program, status, solution["x"], -duals[:e], duals[e:], max(int(stats.get("iter_count", 0)), 0))

    return BoundSolver(run, read)


def bind_nonlinear(
    program: ConicProgram, plugin: str, options: dict[str, Any], infeasible: tuple[str, ...] = ()
) -> BoundSolver:
    """Bind a problem to one of CasADi's solvers of nonlinear programs; cones are smooth inequalities.

    Args:
        program: program to solve.
        plugin: name of the plugin in CasADi.
        options: options of the plugin.
        infeasible: return statuses of the plugin that mean infeasible.
    """
    x = casadi.MX.sym("x", len(program.q))
    e, i = len(program.b), len(program.d)
    rows = [casadi.mtimes(casadi.DM(part), x) for part in (program.A, program.C) if len(part)]
    lower, upper = [program.b, lower_bounds(program)], [program.b, program.d]
    if program.cones:
        S, r = cone_heads(program)
        values = [casadi.DM(right) - casadi.mtimes(casadi.DM(part), x) for part, right in cone_parts(program)]
        rows += [casadi.DM(r) - casadi.mtimes(casadi.DM(S), x), *(v[0] ** 2 - casadi.sumsqr(v[1:]) for v in values)]
        lower.append(np.zeros(2 * len(r)))
        upper.append(np.full(2 * len(r), np.inf))
    cost = 0.5 * casadi.bilin(casadi.DM(program.P), x, x) + casadi.dot(casadi.DM(program.q), x)
    solver = casadi.nlpsol(
        "solver", plugin, {"x": x, "f": cost, "g": casadi.vertcat(*rows)}, {**options, "error_on_fail": False}
    )
    data = {"x0": interior_start(program), "lbg": np.concatenate(lower), "ubg": np.concatenate(upper)}

    def run(start: Any) -> Any:
        return solver(**data), solver.stats()

    def read(output: Any) -> SolverResult:
        solution, stats = output
        is_optimal = stats["success"] and stats["return_status"] != "Feasible_Point_Found"
        status = SolverStatus.SOLVED if is_optimal else SolverStatus.NO_ANSWER
        if stats["return_status"] in infeasible:
            status = SolverStatus.INFEASIBLE
        duals = np.array(solution["lam_g"]).ravel()
        return make_result(program, status, solution["x"], -duals[:e], duals[e : e + i], int(stats.get("iter_count", 0)))

    return BoundSolver(run, read)
