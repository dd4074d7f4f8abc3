"""ProxQP with primal_infeasibility_solving: an infeasible problem is replaced by the nearest feasible one.

The dense solver then often does not terminate, for any tolerance; `benchmarks/proxqp_infeasible.py` tests more variants.
"""

from __future__ import annotations

from typing import Any

from proxsuite import proxqp

from graspforce.bench.adapter import BoundSolver, SolverResult, SolverStatus
from graspforce.bench.solvers.proxqp import bind as bind_proxqp
from graspforce.force.cone_program import ConicProgram

PACKAGE = "proxsuite"
EXACT_CONES = False
WARM_START = False

_NEAREST = proxqp.QPSolverOutput.PROXQP_SOLVED_CLOSEST_PRIMAL_FEASIBLE


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind ProxQP with primal_infeasibility_solving.

    Args:
        program: program without second-order cones.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    bound_solver = bind_proxqp(program, settings, nearest=True)

    def read(qp: Any) -> SolverResult:
        if qp.results.info.status == _NEAREST:
            return SolverResult(SolverStatus.INFEASIBLE, None, None, int(qp.results.info.iter))
        return bound_solver.read(qp)

    return BoundSolver(bound_solver.run, read)
