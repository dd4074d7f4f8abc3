"""Solve a force problem: pick a backend, certify what it says, hand on to another where the proof does not stand.

Without a name the structured kernel is asked first, and Clarabel where the problem has not its structure.
"""

from __future__ import annotations

import dataclasses
import math
import time
import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from graspforce.core.errors import BackendError, UnknownName
from graspforce.force.backends import clarabel, proxqp, qpsolvers, structured
from graspforce.force.certificate import certify, certify_infeasibility
from graspforce.force.infeasibility import add_remedies, describe_infeasibility, infeasibility_multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import TIGHT_TOLERANCE, Certificate, Solution, Status

Backend = Callable[[ForceProblem, "Solution | None"], Solution]

_FALLBACK = "clarabel"


def available_backends() -> tuple[str, ...]:
    """The names that ``backend`` may say on this machine."""
    own = ("structured",) if structured.is_available() else ()
    return (*own, "clarabel", "proxqp", *(name for name in qpsolvers.installed_solvers() if name not in ("clarabel", "proxqp")))


def solve(problem: ForceProblem, backend: str | None = None, *, explain: bool | float = True) -> Solution:
    """The contact forces that hold the object at least cost, proven.

    min cost(f) subject to G f = w, friction cones, normal-force and torque limits (`ForceProblem`). The answer is certified
    before it returns: nothing unverified is called optimal or infeasible. Where a backend's answer cannot be verified the
    problem goes to Clarabel, and `Solution.backend` says whose answer it is.

    Args:
        problem: what to solve.
        backend: a name of `available_backends()`; by default the structured kernel, or Clarabel where the problem
            is not for it.
        explain: where there is no answer, also work out which friction, which torque limits and which nearest wrench would
            give one; takes some hundred times as long as the answer itself. A number: for so many seconds at most, and what
            was not found by then stays None.

    Returns:
        The solution: optimal, inaccurate, infeasible (with the proof) or failed.

    Raises:
        UnknownName: no backend of that name is installed.
        BackendError: the named backend cannot take such a problem.
    """
    answer = _solve_uncertified(problem, backend, None)
    return answer if _is_certified_by_kernel(answer) else _certify_or_fall_back(answer, explain)


class Solver:
    """A force problem that is solved again and again with numbers that change a little; it keeps the last answer.

    For one thread at a time.

    Args:
        problem: the first problem; what later calls do not name stays as it is here.
        backend: a name of `available_backends()`; by default as in `solve`.
        explain: as in `solve`.
    """

    def __init__(self, problem: ForceProblem, backend: str | None = None, *, explain: bool | float = True) -> None:
        self._problem: ForceProblem | None = problem  # None: it is the last answer's, and nobody has asked for it
        self._backend = backend
        self._explain = explain
        self._last_solution: Solution | None = None
        self._session: structured.KernelSession | None = None  # the kernel that found the last answer
        if backend is not None:
            _backend_by_name(backend)

    @property
    def problem(self) -> ForceProblem:
        """The problem as the last call left it."""
        if self._problem is None:
            assert self._last_solution is not None  # solve put it there
            self._problem = self._last_solution.original_problem
        return self._problem

    def solve(
        self, *, w: Any = None, J: Any = None, tau_u: Any = None, mu: Any = None, p: Any = None, R: Any = None
    ) -> Solution:
        """The answer with the named numbers changed; they stay changed. Arguments as in `ForceProblem.replace`.

        Takes least time where what is given are arrays of float64, and not mu.

        Raises:
            InvalidInput: as `ForceProblem.replace`.
            BackendError: another thread is in a call of the same solver.
        """
        start = time.perf_counter()
        answer = None if self._session is None or mu is not None else self._session.solve_changed(start, w, J, tau_u, p, R)
        if answer is not None:
            self._problem, self._last_solution = None, answer
            if _is_certified_by_kernel(answer):
                return answer
        else:
            self._problem = self.problem.replace(w=w, J=J, tau_u=tau_u, mu=mu, p=p, R=R)
            previous = self._last_solution if self._last_solution is not None and self._last_solution.found else None
            answer = self._last_solution = _solve_uncertified(self._problem, self._backend, previous)
        if not _is_certified_by_kernel(answer):
            answer = self._last_solution = _certify_or_fall_back(answer, self._explain)
        self._session = structured.session(answer) if answer.found else None
        return answer


def _solve_uncertified(problem: ForceProblem, backend: str | None, previous: Solution | None) -> Solution:
    """What the backend says, unproven; by default the structured kernel, or Clarabel where that does not take the problem."""
    if backend in (None, "structured") and structured.is_available():
        try:
            return structured.solve(problem, previous)
        except BackendError:
            if backend is not None:
                raise
    elif backend is None:
        _warn_kernel_missing()
    with np.errstate(all="ignore"):  # what overflows cannot be certified, and is not handed out
        return _backend_by_name(backend or _FALLBACK)(problem, previous)


def _is_certified_by_kernel(answer: Solution) -> bool:
    """Whether the certificate in C stands behind an answer already."""
    residuals = answer.residuals
    return residuals is not None and max(residuals) <= TIGHT_TOLERANCE and answer.status is Status.OPTIMAL


@np.errstate(all="ignore")  # what overflows cannot be certified, and is not handed out
def _certify_or_fall_back(answer: Solution, explain: bool | float) -> Solution:
    """The answer with its certificate; another backend's, or a proof that there is none, where its own does not stand."""
    deadline = math.inf if explain is True else time.perf_counter() + explain
    problem = answer.original_problem
    answer = _certify_solution(problem, answer)
    if not _is_final(answer) and answer.backend != _FALLBACK:
        second = _certify_solution(problem, clarabel.solve(problem))
        answer = second if _is_final(second) or not answer.found else answer
    if not _is_final(answer) and not answer.found:
        answer = _with_infeasibility_proof(problem, answer)
    if answer.status is Status.INFEASIBLE and explain:
        answer = _with_infeasibility_proof(problem, answer)
        assert answer.infeasibility is not None  # every certified proof is described
        better = add_remedies(problem, answer.infeasibility, clarabel.solve_program, deadline)
        answer = dataclasses.replace(answer, infeasibility=better)
    return answer


def _with_infeasibility_proof(problem: ForceProblem, answer: Solution) -> Solution:
    """The answer with the tightest proof that there is none; unchanged where that does not stand."""
    proof = infeasibility_multipliers(problem, clarabel.solve_program)
    if proof is None:
        return answer
    refuted = _certify_solution(problem, dataclasses.replace(answer, status=Status.INFEASIBLE, multipliers=proof))
    return refuted if refuted.status is Status.INFEASIBLE else answer


def _is_final(answer: Solution) -> bool:
    """Whether nobody else could do better: proven optimal, or proven infeasible."""
    return answer.status in (Status.OPTIMAL, Status.INFEASIBLE)


@cache
def _warn_kernel_missing() -> None:
    message = (
        "graspforce was installed without a C compiler: Clarabel solves in the structured kernel's place, and takes longer"
    )
    warnings.warn(message, RuntimeWarning, stacklevel=4)


def _backend_by_name(backend: str) -> Backend:
    if backend == "structured" and structured.is_available():
        return structured.solve
    if backend == "clarabel":
        return clarabel.solve
    if backend == "proxqp":
        return proxqp.solve
    if backend in available_backends():
        return lambda problem, previous: qpsolvers.solve(problem, previous, solver=backend)
    raise UnknownName("backend", backend, available_backends())


def _certify_solution(problem: ForceProblem, answer: Solution) -> Solution:
    """The answer with its certificate, its status what the certificate makes of it."""
    multipliers = answer.multipliers
    if multipliers is None or not (len(answer.f) or answer.status is Status.INFEASIBLE):
        return answer.with_verdict(Status.FAILED, None)
    if answer.status is Status.INFEASIBLE:
        infeasibility_proof = certify_infeasibility(problem, multipliers)
        if not infeasibility_proof.certificate.verified:
            return answer.with_verdict(Status.FAILED, None)
        answer = dataclasses.replace(answer, infeasibility=describe_infeasibility(problem, infeasibility_proof))
        return answer.with_verdict(Status.INFEASIBLE, infeasibility_proof.certificate)
    certificate = Certificate.from_residuals(*answer.residuals) if answer.residuals else certify(problem, answer.f, multipliers)
    if not certificate.verified:
        return answer.with_verdict(Status.FAILED, certificate)
    return answer.with_verdict(Status.OPTIMAL if certificate.tolerance <= TIGHT_TOLERANCE else Status.INACCURATE, certificate)
