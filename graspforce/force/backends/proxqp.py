"""ProxQP: a proximal augmented-Lagrangian method for quadratic programs (Bambade et al. 2022). Pyramids only, warm.

It can call a point solved that is far from the optimum, and run for very long on problems that have no answer: its steps are
bounded here, and the certificate judges what it says.
"""

from __future__ import annotations

import time

import numpy as np
from proxsuite import proxqp

from graspforce.core.arrays import Array
from graspforce.core.errors import BackendError
from graspforce.force.cone_program import conic_program
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution, Status, uncertified_solution

_TOLERANCE = 1e-12  # absolute, on rows of unit size: it costs no more steps than 1e-9
_MAX_ITERATIONS = 200  # outer steps; a force problem takes 5 to 20
_NO_LIMIT = 1e20  # ProxQP's own "no bound"


def solve(problem: ForceProblem, previous: Solution | None = None) -> Solution:
    """The answer by ProxQP.

    Args:
        problem: a force problem whose cones are pyramids (or that has none).
        previous: this backend's answer to a problem nearby, to start from.

    Raises:
        BackendError: the problem has exact friction cones.
    """
    start = time.perf_counter()
    program = conic_program(problem)
    if program.cones:
        raise BackendError("proxqp takes pyramids, not exact friction cones: give the problem a pyramid cone, or use clarabel")
    (m, e, i) = len(program.q), len(program.b), len(program.d)
    qp = proxqp.dense.QP(m, e, i)
    qp.settings.eps_abs, qp.settings.eps_rel = _TOLERANCE, 0.0
    qp.settings.max_iter = _MAX_ITERATIONS
    qp.init(program.P, program.q, program.A, program.b, program.C, np.full(i, -_NO_LIMIT), program.d)
    guess = None if previous is None else previous.warm_start
    if _has_sizes(guess, (m, e, i)):
        qp.settings.initial_guess = proxqp.InitialGuess.WARM_START
        qp.solve(*guess)  # type: ignore[misc]  # _fits saw three arrays
    else:
        qp.solve()
    x, y, z = (np.array(part) for part in (qp.results.x, qp.results.y, qp.results.z))
    infeasible = qp.results.info.status == proxqp.QPSolverOutput.PROXQP_PRIMAL_INFEASIBLE
    finite = all(np.isfinite(part).all() for part in (x, y, z))
    status = Status.FAILED if not finite else Status.INFEASIBLE if infeasible else Status.OPTIMAL
    return uncertified_solution(
        problem,
        status,
        program.forces(x) if status is Status.OPTIMAL else None,
        program.multipliers(-y, np.maximum(z, 0.0)) if finite else None,
        backend="proxqp",
        iterations=int(qp.results.info.iter),
        seconds=time.perf_counter() - start,
        warm_start=(x, y, z) if status is Status.OPTIMAL else None,
    )


def _has_sizes(guess: object, sizes: tuple[int, int, int]) -> bool:
    """Whether a restart is ours and of this problem's size."""
    if not isinstance(guess, tuple) or len(guess) != 3:
        return False
    parts: tuple[Array, ...] = guess
    return tuple(len(part) for part in parts) == sizes
