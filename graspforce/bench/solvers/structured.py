"""The project's own kernel (`graspforce.force.backends.structured`), packing of its arrays included in its time."""

from __future__ import annotations

from typing import Any

from graspforce.bench.adapter import BoundSolver, SolverResult, SolverStatus
from graspforce.force.backends import structured
from graspforce.force.cone_program import ConicProgram
from graspforce.force.solution import Solution, Status

PACKAGE = "graspforce"
EXACT_CONES = True
WARM_START = True

if not structured.is_available():
    raise ImportError("the structured kernel was not built")

_STATUS = {
    Status.OPTIMAL: SolverStatus.SOLVED,
    Status.INACCURATE: SolverStatus.SOLVED,
    Status.INFEASIBLE: SolverStatus.INFEASIBLE,
}


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind the force problem itself; this solver does not use the cone program."""
    problem = program.problem

    def run(start: Any) -> Solution:
        return structured.solve(problem, start)

    def read(answer: Solution) -> SolverResult:
        status = _STATUS.get(answer.status, SolverStatus.NO_ANSWER)
        return SolverResult(status, answer.f if status is SolverStatus.SOLVED else None, answer.multipliers, answer.iterations)

    return BoundSolver(run, read)
