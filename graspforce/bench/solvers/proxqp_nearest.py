"""ProxQP asked, by its primal_infeasibility_solving, for the nearest problem with an answer where its own has none.

Its dense solver often does not end then, whatever the tolerances; `benchmarks/proxqp_infeasible.py` tries more ways.
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
    """As ProxQP's own entry, with one more setting."""
    bound_solver = bind_proxqp(program, settings, nearest=True)

    def read(qp: Any) -> SolverResult:
        if qp.results.info.status == _NEAREST:
            return SolverResult(SolverStatus.INFEASIBLE, None, None, int(qp.results.info.iter))
        return bound_solver.read(qp)

    return BoundSolver(bound_solver.run, read)
