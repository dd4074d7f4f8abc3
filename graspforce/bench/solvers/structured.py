"""The structured kernel of this project (`graspforce.force.backends.structured`). Its time includes packing its arrays."""

from __future__ import annotations

from typing import Any

from graspforce.bench.adapter import BoundSolver, SolverResult, SolverStatus
from graspforce.core.errors import UnsupportedProblem
from graspforce.force.backends import compiled_kernel, structured
from graspforce.force.backends.protocol import SolverSettings
from graspforce.force.cone_program import ConicProgram
from graspforce.force.solution import Solution
from graspforce.force.status import Status

PACKAGE = "graspforce"
EXACT_CONES = True
WARM_START = True

if not compiled_kernel.is_available():
    raise ImportError("the structured kernel was not built")

_STATUS = {
    Status.OPTIMAL: SolverStatus.SOLVED,
    Status.INACCURATE: SolverStatus.SOLVED,
    Status.INFEASIBLE: SolverStatus.INFEASIBLE,
}


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind the force problem itself; this solver does not use the cone program.

    Args:
        program: program whose force problem is solved.
        settings: ignored; the kernel runs with its default tolerance.
    """
    problem = program.problem
    if problem.uncertainty is not None:
        raise UnsupportedProblem("the structured kernel solves one problem, not one for all errors")

    def run(start: Any) -> tuple[structured.KernelSession, Solution]:
        session = None if start is None else start[0]
        if session is None or not session.load(problem):
            session = structured.KernelSession(problem, SolverSettings())
        return session, session.solve()

    def read(raw: tuple[structured.KernelSession, Solution]) -> SolverResult:
        solution = raw[1]
        status = _STATUS.get(solution.status, SolverStatus.NO_ANSWER)
        f = solution.f if status is SolverStatus.SOLVED else None
        return SolverResult(status, f, solution.multipliers, solution.iterations)

    return BoundSolver(run, read)
