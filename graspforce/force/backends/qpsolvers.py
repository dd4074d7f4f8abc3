"""Any quadratic-programming solver that the package qpsolvers finds installed. Pyramids only."""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np
import qpsolvers
from scipy import sparse

from graspforce.core.errors import BackendError
from graspforce.force.cone_program import conic_program
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution, Status, uncertified_solution

# Solvers that need P positive definite get this much of the cost's unit on its diagonal. It moves the optimum by about as
# much, relatively; where that matters the certificate says so.
_RIDGE = 1e-10
_NEED_DEFINITE = ("quadprog",)
_MAX_SECONDS = 1.0  # HiGHS can step for ever, and methods of first order for minutes
# What it takes, a solver at a time, to come within reach of the certificate's 1e-8, and to come back.
_SOLVER_SETTINGS: dict[str, dict[str, Any]] = {
    "osqp": {"eps_abs": 1e-10, "eps_rel": 0.0, "max_iter": 200_000, "time_limit": _MAX_SECONDS},
    "scs": {"eps_abs": 1e-10, "eps_rel": 0.0, "max_iters": 200_000, "time_limit_secs": _MAX_SECONDS},
    "piqp": {"eps_abs": 1e-10, "eps_rel": 0.0},
    "proxqp": {"eps_abs": 1e-10, "eps_rel": 0.0, "max_iter": 200},
    "daqp": {"primal_tol": 1e-10, "dual_tol": 1e-10, "time_limit": _MAX_SECONDS},
    "highs": {"time_limit": _MAX_SECONDS},
}


def installed_solvers() -> tuple[str, ...]:
    """The names of the solvers that qpsolvers finds."""
    return tuple(sorted(qpsolvers.available_solvers))


def solve(problem: ForceProblem, previous: Solution | None = None, *, solver: str) -> Solution:
    """The answer by one of qpsolvers' solvers.

    Args:
        problem: a force problem whose cones are pyramids (or that has none).
        previous: not used.
        solver: a name of `installed_solvers`.

    Raises:
        BackendError: the problem has exact friction cones.
    """
    start = time.perf_counter()
    program = conic_program(problem)
    if program.cones:
        raise BackendError(
            f"{solver} takes pyramids, not exact friction cones: give the problem a pyramid cone, or use clarabel"
        )
    quadratic: Any = program.P + (_RIDGE * np.eye(len(program.q)) if solver in _NEED_DEFINITE else 0.0)
    equalities: Any = program.A
    inequalities: Any = program.C
    if solver not in qpsolvers.dense_solvers:
        quadratic, equalities, inequalities = (sparse.csc_matrix(part) for part in (quadratic, equalities, inequalities))
    if not len(program.d):
        inequalities = None
    bounds = None if inequalities is None else program.d
    qp = qpsolvers.Problem(quadratic, program.q, inequalities, bounds, equalities, program.b)
    settings: dict[str, Any] = _SOLVER_SETTINGS.get(solver, {})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a solver's doubts about its answer are for the certificate to settle
        try:
            answer = qpsolvers.solve_problem(qp, solver=solver, **settings)
        except Exception:  # each solver has exceptions of its own, for problems that it cannot take or finish
            answer = qpsolvers.Solution(qp)
    x = answer.x
    found = x is not None and answer.y is not None and bool(np.isfinite(x).all())
    forces = program.forces(x) if found and x is not None else None
    z = np.zeros(len(program.d)) if answer.z is None else np.maximum(answer.z, 0.0)
    return uncertified_solution(
        problem,
        Status.OPTIMAL if found else Status.FAILED,
        forces,
        program.multipliers(-np.asarray(answer.y), z) if found else None,
        backend=solver,
        iterations=int(answer.extras.get("iter", 0) or 0),
        seconds=time.perf_counter() - start,
    )
