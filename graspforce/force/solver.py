"""Solve force problems and certify the solutions.

A backend claims a solution, and the certificate verifies it. If verification fails, the fallback solves the problem again. The
tightest proof of infeasibility comes from a cone program of its own.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, UnsupportedProblem
from graspforce.force.backends import registry
from graspforce.force.backends.protocol import Backend, Session, SolverSettings
from graspforce.force.certificate import certify, certify_infeasibility
from graspforce.force.cone_program import ConicSolver
from graspforce.force.extreme_optima import find_distant_optimum, find_small_optimum, is_margin_unbounded
from graspforce.force.infeasibility import (
    DeadlinePassed,
    add_remedies,
    describe_infeasibility,
    infeasibility_multipliers,
    solver_with_deadline,
)
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.scale import scale
from graspforce.force.solution import Solution
from graspforce.force.status import Status

_DEFAULT_SETTINGS = SolverSettings()
_LARGE_FORCE = 1e6  # force units: the size of forces for which the backends' tolerances are too coarse
_OBJECTIVE_TOLERANCE = 1e-7  # of the gap relative to the objective
_MAX_REFINEMENTS = 5
_COST_UNITS = (1.0, 10.0, 0.1)  # times the cost, tried in this order in each refinement
_WIDE_WEIGHTS = 1e4  # ratio of torque weights from which the optimal cost can be far below its unit
_SHORTEST_TIME = 1e-9  # s: the time limit of a solver whose time is over
_SUFFICIENT_REACH = 1e9  # force units: proofs that cover less leave room for a search with larger forces


def solve(
    problem: ForceProblem,
    backend: str | None = None,
    *,
    settings: SolverSettings | None = None,
    guess: Solution | None = None,
    explain: bool = True,
    explain_seconds: float | None = None,
    deadline: float | None = None,
) -> Solution:
    """Return the contact forces of least cost, certified.

    The problem is min cost(f) subject to G f = w, friction cones, and limits on normal forces and motor torques
    (`ForceProblem`). A solution is called optimal or infeasible only if its certificate proves it. If a backend's solution
    cannot be certified, the fallback solves the problem again; `Solution.backend` names the solver of the solution.

    Args:
        problem: the force problem.
        backend: a name of `available_backends`; by default the fastest one that supports the problem.
        settings: tolerance and limits of the solver; by default the backend's own.
        guess: solution of a nearby problem; backends with a warm start from forces start there.
        explain: for an infeasible problem, also compute the factors on friction and torque limits that make it feasible,
            and the nearest feasible wrench. This takes some hundred times as long as the solution.
        explain_seconds: limit on the time of the explanation, s; numbers not found by then are None. Default: no limit.
        deadline: time of the whole call, s. When it is over, solvers stop: the kernel after its iteration. Without a certified
            answer by then, the solution is failed, with `Solution.timed_out`. Default: no limit.

    Returns:
        The solution: optimal, inaccurate, infeasible (with the proof) or failed.

    Raises:
        UnknownName: no backend of that name is available.
        UnsupportedProblem: the named backend does not support the problem.
        InvalidInput: explain_seconds or deadline is negative, or the objective is "margin" and no limit bounds the margin.
    """
    limit = _explanation_limit(explain, explain_seconds)
    settings, end = settings or _DEFAULT_SETTINGS, math.inf
    if deadline is not None:
        end = time.perf_counter() + arrays.check_number(deadline, "deadline", minimum=0.0)
        settings = _limited(settings, max(deadline, _SHORTEST_TIME))
    if problem.uncertainty is not None:
        from graspforce.force.robust_program import solve_robust  # imported here because it imports the general backend

        return solve_robust(problem, settings)
    chosen = registry.preferred_backend() if backend is None else registry.find_backend(backend)
    try:
        solution = chosen.solve(problem, settings, guess)
    except UnsupportedProblem:
        if backend is not None:
            raise
        solution = registry.general_backend().solve(problem, settings, guess)
    if not (solution.is_final and (solution.found or (limit == 0.0 and not _has_short_reach(solution)))):
        solution = _certify_or_fall_back(solution, settings, limit, end)
    if solution.status is Status.FAILED and time.perf_counter() >= end:
        return dataclasses.replace(solution, timed_out=True)
    return _refine_objective(solution, end) if _has_wide_weights(problem) else solution


class Solver:
    """A force problem that is solved repeatedly with changed values, each time from the last solution.

    Use one solver per thread.

    Args:
        problem: the first problem. Values that later calls do not change stay as they are.
        backend, settings, explain, explain_seconds: as in `solve`.
        deadline: time of each call of `solve`, s. When it is over, the last certified solution is returned again, with
            `Solution.timed_out`; its forces suit the numbers of that solve. An iteration of the kernel, or a step of the
            fallback that has begun, is not interrupted. Default: no limit.

    Raises:
        UnknownName: no backend of that name is available.
        InvalidInput: explain_seconds is negative, or deadline is not positive, or given for a problem with an uncertainty.
    """

    def __init__(
        self,
        problem: ForceProblem,
        backend: str | None = None,
        *,
        settings: SolverSettings | None = None,
        explain: bool = True,
        explain_seconds: float | None = None,
        deadline: float | None = None,
    ) -> None:
        self._problem = problem  # as the last solve left it, unless there is a session
        self._settings = settings or _DEFAULT_SETTINGS
        self._deadline = deadline
        self._last: Solution | None = None  # the last certified one, with a deadline
        if deadline is not None:
            arrays.check_number(deadline, "deadline", above=0.0)
            if problem.uncertainty is not None:
                raise InvalidInput("deadline", deadline, "absent for a problem with an uncertainty")
            self._settings = _limited(self._settings, deadline)
        self._limit = _explanation_limit(explain, explain_seconds)
        self._refines = _has_wide_weights(problem)
        self._backend: Backend | None = None if backend is None else registry.find_backend(backend)
        self._session: Session | None = None
        self._is_robust = problem.uncertainty is not None
        if self._is_robust:
            from graspforce.force.robust_session import RobustSession  # imports the general backend

            self._session = RobustSession(problem, self._settings, self._backend or registry.preferred_backend())
        registry.general_backend()  # imported now, so that the first fallback in a control loop is not late

    @property
    def problem(self) -> ForceProblem:
        """The problem as the last solve left it."""
        return self._problem if self._session is None else self._session.problem

    def solve(
        self,
        *,
        w: npt.ArrayLike | None = None,
        J: npt.ArrayLike | None = None,
        tau_u: npt.ArrayLike | None = None,
        mu: npt.ArrayLike | None = None,
        p: npt.ArrayLike | None = None,
        R: npt.ArrayLike | None = None,
        normal_limits: npt.ArrayLike | None = None,
    ) -> Solution:
        """Return the certified solution for changed values; the changes persist. Fastest for float64 arrays.

        Args:
            w: (6,) wrench that the contacts supply, in O, N and N·m.
            J: (k, n) hand Jacobian, m/rad.
            tau_u: (n,) motor torques without contact, N·m.
            mu: (N,) friction coefficients, or (2, N) with the torsional friction lengths in the second row, m.
            p: (N, 3) contact positions in O, m.
            R: (N, 3, 3) contact frames in O.
            normal_limits: (2, N) smallest and largest normal forces, N; inf for no upper limit.

        Raises:
            InvalidInput: as `ForceProblem.replace`, the problem stays as it was; or a margin that no limit bounds.
            BackendError: another thread uses this solver, or the named backend does not support the problem.
        """
        start = 0.0 if self._deadline is None else time.perf_counter()
        solution = None
        if self._session is not None:
            if self._is_robust:
                return self._session.solve(w, J, tau_u, mu, p, R, normal_limits)
            try:
                solution = self._session.solve(w, J, tau_u, mu, p, R, normal_limits)
            except UnsupportedProblem:
                self._end_session()
        if solution is None:
            self._problem = self._problem.replace(w=w, J=J, tau_u=tau_u, mu=mu, p=p, R=R, normal_limits=normal_limits)
            self._session, solution = self._start_session()
        if solution.is_final and (solution.found or (self._limit == 0.0 and not _has_short_reach(solution))):
            self._last = solution if self._deadline is not None and solution.found else self._last
            return _refine_objective(solution) if self._refines and self._deadline is None else solution
        if self._deadline is not None:
            return self._finish_in_time(solution, start + self._deadline)
        solver = solution.backend
        solution = _certify_or_fall_back(solution, self._settings, self._limit)
        if not solution.found or solution.backend != solver:  # the session's iterate is no start for the next solve
            self._end_session()
        return _refine_objective(solution) if self._refines else solution

    def _finish_in_time(self, solution: Solution, end: float) -> Solution:
        """Return the certified solution, the fallback's if there is time for it, or else the last certified one.

        Args:
            solution: solution of the session, which is not certified optimal.
            end: end of the time, on the clock `time.perf_counter`, s.
        """
        problem, fallback = solution.original_problem, registry.general_backend()
        with np.errstate(all="ignore"):  # a solution that overflows is not certified
            solution = _certify_solution(problem, solution)
            rest = end - time.perf_counter()
            if not solution.is_final and solution.backend != fallback.name and rest > 0.0:
                second = _certify_solution(problem, fallback.solve(problem, SolverSettings(time_limit=rest)))
                solution = second if second.is_final or not solution.found else solution
        if solution.status is Status.FAILED:
            self._end_session()
            last = self._last
            is_late = time.perf_counter() >= end
            if last is None or not is_late:
                return dataclasses.replace(solution, timed_out=is_late)
            parts = {field.name: getattr(last, field.name) for field in dataclasses.fields(Solution)}
            return Solution(**{**parts, "timed_out": True})
        self._last = solution if solution.found else self._last
        return solution

    def _start_session(self) -> tuple[Session, Solution]:
        """Return a session of the backend, or of the general one if the problem requires it, and its solution."""
        backend = self._backend or registry.preferred_backend()
        try:
            session = backend.start_session(self._problem, self._settings)
            return session, session.solve()
        except UnsupportedProblem:
            if self._backend is not None:
                raise
            session = registry.general_backend().start_session(self._problem, self._settings)
            return session, session.solve()

    def _end_session(self) -> None:
        """Keep the session's problem, and drop the session."""
        self._problem = self.problem
        self._session = None


def _limited(settings: SolverSettings, seconds: float) -> SolverSettings:
    """Return the settings with a time limit of at most the given one, s."""
    return dataclasses.replace(settings, time_limit=min(seconds, settings.time_limit or math.inf))


def _explanation_limit(explain: bool, explain_seconds: float | None) -> float:
    """Return the time limit of the explanation of infeasibility, s: 0 without, infinite by default."""
    if explain_seconds is None:
        return math.inf if explain else 0.0
    arrays.check_number(explain_seconds, "explain_seconds", minimum=0.0)
    return explain_seconds if explain else 0.0


@np.errstate(all="ignore")  # a solution that overflows is not certified
def _certify_or_fall_back(
    solution: Solution, settings: SolverSettings, explanation_limit: float, end: float = math.inf
) -> Solution:
    """Return the certified solution; the fallback's, or a proof of infeasibility, if its own certificate fails.

    Args:
        solution: a backend's solution.
        settings: of the backend.
        explanation_limit: time of the explanation, s.
        end: end of the time of everything, on the clock `time.perf_counter`, s.
    """
    deadline = min(time.perf_counter() + explanation_limit, end)
    problem, fallback = solution.original_problem, registry.general_backend()
    solve_program = solver_with_deadline(fallback.solve_program, end)
    solution = _certify_solution(problem, solution)
    if not solution.is_final and solution.backend != fallback.name and time.perf_counter() < end:
        own_settings = SolverSettings(time_limit=settings.time_limit)  # the tolerance may be why certification failed
        if math.isfinite(end):
            own_settings = _limited(own_settings, max(end - time.perf_counter(), _SHORTEST_TIME))
        second = _certify_solution(problem, fallback.solve(problem, own_settings))
        solution = second if second.is_final or not solution.found else solution
    with contextlib.suppress(DeadlinePassed):
        if not solution.is_final and not solution.found:
            solution = _with_infeasibility_proof(problem, solution, solve_program)
        if solution.status is Status.FAILED or _has_short_reach(solution):
            solution = _search_large_forces(problem, solution, solve_program)
        failed_margin = solution.status is Status.FAILED and problem.objective.type == "margin"
        if failed_margin and is_margin_unbounded(problem, solve_program):
            raise InvalidInput("objective.type", "margin", "another objective: no limit bounds the margin of these contacts")
        if solution.status is Status.INFEASIBLE and explanation_limit > 0.0:
            solution = _with_infeasibility_proof(problem, solution, solve_program)
            assert solution.infeasibility is not None  # every certified proof has a description
            infeasibility = add_remedies(problem, solution.infeasibility, fallback.solve_program, deadline)
            solution = dataclasses.replace(solution, infeasibility=infeasibility)
    return solution


def _with_infeasibility_proof(problem: ForceProblem, solution: Solution, solve_program: ConicSolver) -> Solution:
    """Return the solution with the tightest proof of infeasibility; unchanged if the proof does not hold."""
    multipliers = infeasibility_multipliers(problem, solve_program)
    if multipliers is None:
        return solution
    claim = dataclasses.replace(solution, status=Status.INFEASIBLE, multipliers=multipliers, certificate=None)
    proven = _certify_solution(problem, claim)
    return proven if proven.status is Status.INFEASIBLE else solution


def _has_short_reach(solution: Solution) -> bool:
    """Return whether a solution's proof of infeasibility covers forces up to less than `_SUFFICIENT_REACH` only."""
    certificate = solution.certificate
    return not solution.found and certificate is not None and certificate.gap < _SUFFICIENT_REACH * certificate.dual_residual


def _has_wide_weights(problem: ForceProblem) -> bool:
    """Return whether the torque weights of a problem differ so much that its optimal cost can be far below its unit."""
    if problem.actuation is None or problem.objective.type != "torque":
        return False
    weights = problem.actuation.weight.tolist()  # for a few joints, floats are faster than arrays
    return bool(weights) and max(weights) / _WIDE_WEIGHTS > min(weights)


@np.errstate(all="ignore")  # a solution that overflows is not certified
def _refine_objective(solution: Solution, end: float = math.inf) -> Solution:
    """Return the certified solution with the smallest gap relative to its objective, where that gap is not small."""
    problem, solve_program = solution.original_problem, solver_with_deadline(registry.general_backend().solve_program, end)
    with contextlib.suppress(DeadlinePassed):
        for _ in range(_MAX_REFINEMENTS):
            gap = solution.objective_gap
            if gap is None or gap <= _OBJECTIVE_TOLERANCE or solution.objective is None:
                break
            for unit in _COST_UNITS:  # the solver's last digits depend on the unit
                optimum = find_small_optimum(problem, unit * abs(solution.objective), solve_program)
                refined = solution if optimum is None else _with_forces(solution, *optimum)
                if refined.objective_gap is not None and refined.objective_gap < gap and refined.is_final:
                    break
            else:
                break
            solution = refined
    return solution


def _with_forces(solution: Solution, f: Array, multipliers: Multipliers) -> Solution:
    """Return a solution with other forces and multipliers of the general backend, certified."""
    found = Solution(
        Status.OPTIMAL,
        solution.original_problem,
        arrays.freeze(f),
        None,
        None,
        registry.general_backend().name,
        solution.iterations,
        solution.seconds,
        multipliers,
    )
    return _certify_solution(solution.original_problem, found)


def _search_large_forces(problem: ForceProblem, solution: Solution, solve_program: ConicSolver) -> Solution:
    """Return a certified optimum with forces beyond a proof's reach, or far above the force unit; otherwise the solution."""
    reach = None if solution.infeasibility is None else solution.infeasibility.reach
    force = reach or _LARGE_FORCE * float(scale(problem).force)  # N
    optimum = find_distant_optimum(problem, force, solve_program)
    if optimum is None:
        return solution
    found = _with_forces(solution, *optimum)
    return found if found.found else solution


def _certify_solution(problem: ForceProblem, solution: Solution) -> Solution:
    """Return the solution with its certificate, and the status that the certificate proves."""
    multipliers = solution.multipliers
    if solution.certificate is not None:  # computed by the backend, in C
        return solution
    if multipliers is None or not (len(solution.f) or solution.status is Status.INFEASIBLE):
        return solution.with_verdict(Status.FAILED, None)
    if solution.status is Status.INFEASIBLE:
        proof = certify_infeasibility(problem, multipliers)
        if not proof.certificate.verified:
            return solution.with_verdict(Status.FAILED, None)
        solution = dataclasses.replace(solution, infeasibility=describe_infeasibility(problem, proof))
        return solution.with_verdict(Status.INFEASIBLE, proof.certificate)
    return solution.with_certificate(certify(problem, solution.f, multipliers))
