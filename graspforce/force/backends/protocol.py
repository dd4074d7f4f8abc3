"""The interface of solver backends, and the settings that a user can change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.records import set_fields
from graspforce.force.cone_program import ConicProgram, ConicResult
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution

_MAX_ITERATIONS = 10**9
MAX_SHORT_STEPS = 10**6  # that the kernel accepts


@dataclass(frozen=True, slots=True)
class SolverSettings:
    """Settings of a solver; None selects the backend's own default, which suits the certificate's tolerance.

    The settings do not change what counts as optimal: the certificate has fixed tolerances.

    Args:
        tolerance: bound on the solver's own scaled residuals, > 0.
        max_iterations: limit on the iterations, at least 1.
        time_limit: limit on the time of one solve, s, > 0. ProxQP has no such limit.
        short_steps: limit on the short steps of the kernel, at least 0, which follow where its first iterations end without a
            verdict. Default: none with `max_iterations`, otherwise the number that the theorem states for a reduction of all
            residuals to 1e-24. Other backends ignore it.

    Raises:
        InvalidInput: a value outside its range.
    """

    tolerance: float | None = None
    max_iterations: int | None = None
    time_limit: float | None = None
    short_steps: int | None = None

    def __post_init__(self) -> None:
        """Validate the values."""
        for name in ("tolerance", "time_limit"):
            if getattr(self, name) is not None:
                set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})
        if self.short_steps is not None:
            fields.check_integer(self.short_steps, "short_steps", minimum=0, maximum=MAX_SHORT_STEPS)
        if self.max_iterations is not None:
            fields.check_integer(self.max_iterations, "max_iterations", minimum=1, maximum=_MAX_ITERATIONS)


class Session(Protocol):
    """A backend bound to one problem whose values change from one solve to the next. It keeps the warm-start state."""

    @property
    def problem(self) -> ForceProblem:
        """The problem as the last solve left it."""

    def solve(
        self,
        w: npt.ArrayLike | None = None,
        J: npt.ArrayLike | None = None,
        tau_u: npt.ArrayLike | None = None,
        mu: npt.ArrayLike | None = None,
        p: npt.ArrayLike | None = None,
        R: npt.ArrayLike | None = None,
        normal_limits: npt.ArrayLike | None = None,
    ) -> Solution:
        """Return the solution for changed values; the other values stay. Arguments as in `ForceProblem.replace`.

        Raises:
            InvalidInput: as `ForceProblem.replace`; the session stays as it was.
            UnsupportedProblem: the backend does not support the changed problem; the session stays as it was.
            BackendError: another thread uses the session.
        """


class Backend(Protocol):
    """A solver for force problems. Its solutions need no certificate: the caller certifies them."""

    @property
    def name(self) -> str:
        """The name by which users select the backend."""

    @property
    def unavailable_reason(self) -> str:
        """Why the backend is not available in this installation; empty if it is."""

    def solve(self, problem: ForceProblem, settings: SolverSettings, guess: Solution | None = None) -> Solution:
        """Return the solution of one problem, with the solver's own claim as its status.

        Args:
            problem: the force problem.
            settings: tolerance and limits.
            guess: solution of a nearby problem with as many force components. It affects speed only; backends without a
                warm start from forces ignore it.

        Raises:
            UnsupportedProblem: the backend does not support such a problem.
        """

    def start_session(self, problem: ForceProblem, settings: SolverSettings) -> Session:
        """Return a session for repeated solves of a problem.

        Args:
            problem: the force problem.
            settings: tolerance and limits of every solve.

        Raises:
            UnsupportedProblem: the backend does not support such a problem.
        """


class ConicBackend(Backend, Protocol):
    """A backend that solves every force problem, and cone programs in standard form."""

    def solve_program(self, program: ConicProgram, time_limit: float | None = None) -> ConicResult:
        """Return the result of a cone program.

        Args:
            program: the program.
            time_limit: time after which the solver stops, s, > 0; the result is then not converged.
        """


class SimpleSession:
    """A session that solves every changed problem as a whole.

    Args:
        problem: the first problem.
        solve: returns the solution of a problem.
    """

    def __init__(self, problem: ForceProblem, solve: Callable[[ForceProblem], Solution]) -> None:
        self.problem = problem
        self._solve = solve

    def solve(
        self,
        w: npt.ArrayLike | None = None,
        J: npt.ArrayLike | None = None,
        tau_u: npt.ArrayLike | None = None,
        mu: npt.ArrayLike | None = None,
        p: npt.ArrayLike | None = None,
        R: npt.ArrayLike | None = None,
        normal_limits: npt.ArrayLike | None = None,
    ) -> Solution:
        """Return the solution for changed values, as `Session.solve`."""
        problem = self.problem.replace(w=w, J=J, tau_u=tau_u, mu=mu, p=p, R=R, normal_limits=normal_limits)
        solution = self._solve(problem)
        self.problem = problem
        return solution
