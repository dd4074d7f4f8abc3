"""IPOPT: an interior-point method for nonlinear programs (Wächter and Biegler 2006), from CasADi. A baseline.

Cones are smooth inequalities (`graspforce.bench.smooth_cones`), with exact derivatives. With cones the inequalities are not
concave functions, so that a stationary point of infeasibility proves nothing; it then counts as no answer.
"""

from __future__ import annotations

from graspforce.bench import casadi_adapter
from graspforce.bench.adapter import TOLERANCE, BoundSolver
from graspforce.force.cone_program import ConicProgram

PACKAGE = "casadi"
EXACT_CONES = True
WARM_START = False


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind IPOPT. By default it relaxes bounds by 1e-8, which exceeds the tolerance of the settings "high".

    Args:
        program: program to solve.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    tolerance = TOLERANCE[settings]
    options: dict[str, object] = {"print_level": 0, "sb": "yes"}
    if tolerance is not None:
        names = ("tol", "constr_viol_tol", "dual_inf_tol", "compl_inf_tol")
        options |= dict.fromkeys(names, tolerance)
        options |= {"bound_relax_factor": min(1e-8, tolerance) if settings == "low" else 0.0}
    infeasible = () if program.cones else ("Infeasible_Problem_Detected",)
    return casadi_adapter.bind_nonlinear(program, "ipopt", {"ipopt": options, "print_time": False}, infeasible)
