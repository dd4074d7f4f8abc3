"""ProxQP: a proximal augmented Lagrangian method for quadratic programs (Bambade et al. 2022), with warm start.

ProxQP supports pyramids only. It can report a point as solved that is far from the optimum, and it can iterate for a very long
time on infeasible problems. Its iterations are therefore limited here, and the certificate judges its results.
"""

from __future__ import annotations

import time

import numpy as np
from proxsuite import proxqp

from graspforce.core.arrays import Array
from graspforce.core.errors import UnsupportedProblem
from graspforce.force.backends.protocol import Backend, SimpleSession, SolverSettings
from graspforce.force.cone_program import conic_program
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution, uncertified_solution
from graspforce.force.status import Status

_TOLERANCE = 1e-12  # absolute, on rows of unit size; needs no more iterations than 1e-9
_MAX_ITERATIONS = 200  # outer iterations; a force problem needs 5 to 20
_NO_LIMIT = 1e20  # ProxQP's value for "no bound"

Point = tuple[Array, Array | None, Array | None]  # x, y and z of the scaled program; None for unknown multipliers


class ProxqpBackend:
    """ProxQP as a backend."""

    name = "proxqp"
    unavailable_reason = ""

    def solve(self, problem: ForceProblem, settings: SolverSettings, guess: Solution | None = None) -> Solution:
        """Return the solution of a problem with pyramids, as `Backend.solve`; a guess gives the first forces."""
        start: Point | None = None
        if guess is not None and len(guess.f) == problem.size:
            start = (conic_program(problem).variables(guess.f), None, None)
        return _solve(problem, settings, start)[0]

    def start_session(self, problem: ForceProblem, settings: SolverSettings) -> SimpleSession:
        """Return a session in which ProxQP starts from its last variables and multipliers."""
        last: Point | None = None

        def solve(changed: ForceProblem) -> Solution:
            nonlocal last
            solution, last = _solve(changed, settings, last)
            return solution

        return SimpleSession(problem, solve)


BACKENDS: tuple[Backend, ...] = (ProxqpBackend(),)


@np.errstate(all="ignore")  # a solution that overflows is not certified
def _solve(problem: ForceProblem, settings: SolverSettings, start: Point | None) -> tuple[Solution, Point | None]:
    """Return the solution, and the point from which the next solve can start."""
    clock = time.perf_counter()
    program = conic_program(problem)
    if program.cones:
        raise UnsupportedProblem(
            "proxqp supports pyramids, not exact friction cones: give the problem a pyramid cone, or use clarabel"
        )
    m, e, i = len(program.q), len(program.b), len(program.d)
    qp = proxqp.dense.QP(m, e, i)
    qp.settings.eps_abs, qp.settings.eps_rel = settings.tolerance or _TOLERANCE, 0.0
    qp.settings.max_iter = settings.max_iterations or _MAX_ITERATIONS
    qp.init(program.P, program.q, program.A, program.b, program.C, np.full(i, -_NO_LIMIT), program.d)
    if start is not None and _has_sizes(start, (m, e, i)):
        qp.settings.initial_guess = proxqp.InitialGuess.WARM_START
        qp.solve(*start)
    else:
        qp.solve()
    x, y, z = (np.array(part) for part in (qp.results.x, qp.results.y, qp.results.z))
    infeasible = qp.results.info.status == proxqp.QPSolverOutput.PROXQP_PRIMAL_INFEASIBLE
    finite = all(np.isfinite(part).all() for part in (x, y, z))
    status = Status.FAILED if not finite else Status.INFEASIBLE if infeasible else Status.OPTIMAL
    solution = uncertified_solution(
        problem,
        status,
        program.forces(x) if status is Status.OPTIMAL else None,
        program.multipliers(-y, np.maximum(z, 0.0)) if finite else None,
        backend=ProxqpBackend.name,
        iterations=int(qp.results.info.iter),
        seconds=time.perf_counter() - clock,
    )
    return solution, (x, y, z) if status is Status.OPTIMAL else None


def _has_sizes(point: Point, sizes: tuple[int, int, int]) -> bool:
    """Return whether the parts of a point have the sizes of the program."""
    return all(part is None or len(part) == size for part, size in zip(point, sizes, strict=True))
