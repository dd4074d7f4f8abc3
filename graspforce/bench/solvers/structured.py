"""The structured kernel of this project (`graspforce.force.backends.structured`). Its time includes packing its arrays.

Robust cases run as in `RobustSession`: the kernel solves nominal problems with shifted forces, until their optimum holds for
all errors. The session's fallback to Clarabel does not count. A case is unsupported if the shifted problems do not represent
it, as with pyramids and the objective "max_normal". If more than two errors limit a contact, the kernel has no answer.
"""

from __future__ import annotations

from typing import Any

from graspforce.bench.adapter import BoundSolver, SolverResult, SolverStatus
from graspforce.core.arrays import Array
from graspforce.core.errors import UnsupportedProblem
from graspforce.force.backends import compiled_kernel, structured
from graspforce.force.backends.protocol import SolverSettings
from graspforce.force.cone_program import ConicProgram
from graspforce.force.problem import ForceProblem
from graspforce.force.robust_session import ShiftedProblem, is_supported
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
        return _bind_robust(problem)

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


def _bind_robust(problem: ForceProblem) -> BoundSolver:
    """Bind a problem with errors of friction, load and normals.

    Args:
        problem: problem with an uncertainty.

    Raises:
        UnsupportedProblem: shifted problems do not represent this one.
    """
    if not is_supported(problem):
        raise UnsupportedProblem("robust problems need exact cones and errors, and another objective than max_normal")
    backend = structured.KernelBackend()
    shifted = ShiftedProblem(problem)  # the maps of the errors, which the cone program of other solvers holds too

    def run(start: Any) -> tuple[Array, Solution] | None:
        return shifted.solve(problem, SolverSettings(), backend) if shifted.is_supplied else None

    def read(raw: tuple[Array, Solution] | None) -> SolverResult:
        if raw is None:
            return SolverResult(SolverStatus.NO_ANSWER, None, None, 0)
        f, solution = raw
        return SolverResult(SolverStatus.SOLVED, f, None, solution.iterations)  # its multipliers are those of one error

    return BoundSolver(run, read)
