"""Every quadratic-programming solver that the package qpsolvers finds installed. They support pyramids only."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import qpsolvers
from scipy import sparse

from graspforce.core.errors import UnsupportedProblem
from graspforce.force.backends.protocol import Backend, SimpleSession, SolverSettings
from graspforce.force.cone_program import conic_program
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution, uncertified_solution
from graspforce.force.status import Status

# Solvers that require a positive definite P get this share of the cost's unit on its diagonal. It moves the optimum by about
# as much, relative to the cost.
_RIDGE = 1e-10
_NEED_DEFINITE = ("quadprog",)
_TOLERANCE = 1e-10  # with it the solutions reach the certificate's tolerance
_MAX_SECONDS = 1.0  # HiGHS may never end, and first-order methods may take minutes


@dataclass(frozen=True)
class _Options:
    """The names of a solver's own settings.

    Args:
        tolerance: names of its tolerances.
        max_iterations: name of its limit on iterations; empty without one.
        time_limit: name of its limit on time, s; empty without one.
        defaults: values of other settings.
    """

    tolerance: tuple[str, ...] = ()
    max_iterations: str = ""
    time_limit: str = ""
    defaults: dict[str, float] = field(default_factory=dict)


_ABSOLUTE = {"eps_rel": 0.0}
_OPTIONS = {
    "osqp": _Options(("eps_abs",), "max_iter", "time_limit", {**_ABSOLUTE, "max_iter": 200_000}),
    "scs": _Options(("eps_abs",), "max_iters", "time_limit_secs", {**_ABSOLUTE, "max_iters": 200_000}),
    "piqp": _Options(("eps_abs",), "max_iter", "", _ABSOLUTE),
    "proxqp": _Options(("eps_abs",), "max_iter", "", {**_ABSOLUTE, "max_iter": 200}),
    "daqp": _Options(("primal_tol", "dual_tol"), "iter_limit", "time_limit"),
    "highs": _Options((), "", "time_limit"),
}


class QpsolversBackend:
    """One of the solvers of qpsolvers as a backend.

    Args:
        name: its name in qpsolvers.
    """

    unavailable_reason = ""

    def __init__(self, name: str) -> None:
        self.name = name

    @np.errstate(all="ignore")  # a solution that overflows is not certified
    def solve(self, problem: ForceProblem, settings: SolverSettings, guess: Solution | None = None) -> Solution:
        """Return the solution of a problem with pyramids, as `Backend.solve`."""
        start = time.perf_counter()
        program = conic_program(problem)
        if program.cones:
            raise UnsupportedProblem(
                f"{self.name} supports pyramids, not exact friction cones: give the problem a pyramid cone, or use clarabel"
            )
        ridge = _RIDGE * np.eye(len(program.q)) if self.name in _NEED_DEFINITE else 0.0
        quadratic: Any = program.P + ridge
        equalities: Any = program.A
        inequalities: Any = program.C
        if self.name not in qpsolvers.dense_solvers:
            quadratic, equalities, inequalities = (sparse.csc_matrix(part) for part in (quadratic, equalities, inequalities))
        if not len(program.d):
            inequalities = None
        bounds = None if inequalities is None else program.d
        qp = qpsolvers.Problem(quadratic, program.q, inequalities, bounds, equalities, program.b)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the certificate decides whether the result is accurate
            try:
                result = qpsolvers.solve_problem(qp, solver=self.name, **_solver_options(self.name, settings))
            except Exception:  # every solver has its own exceptions for problems that it cannot solve
                result = qpsolvers.Solution(qp)
        x, y = result.x, result.y
        found = x is not None and y is not None and bool(np.isfinite(x).all())
        z = np.zeros(len(program.d)) if result.z is None else np.maximum(result.z, 0.0)
        return uncertified_solution(
            problem,
            Status.OPTIMAL if found else Status.FAILED,
            program.forces(x) if found and x is not None else None,
            program.multipliers(-np.asarray(y), z) if found else None,
            backend=self.name,
            iterations=int(result.extras.get("iter", 0) or 0),
            seconds=time.perf_counter() - start,
        )

    def start_session(self, problem: ForceProblem, settings: SolverSettings) -> SimpleSession:
        """Return a session that solves every changed problem as a whole."""
        return SimpleSession(problem, lambda changed: self.solve(changed, settings))


BACKENDS: tuple[Backend, ...] = tuple(QpsolversBackend(name) for name in sorted(qpsolvers.available_solvers))


def _solver_options(name: str, settings: SolverSettings) -> dict[str, Any]:
    """Return a solver's own settings."""
    names = _OPTIONS.get(name, _Options())
    options: dict[str, Any] = {**dict.fromkeys(names.tolerance, settings.tolerance or _TOLERANCE), **names.defaults}
    if names.max_iterations and settings.max_iterations is not None:
        options[names.max_iterations] = settings.max_iterations
    if names.time_limit:
        options[names.time_limit] = settings.time_limit or _MAX_SECONDS
    return options
