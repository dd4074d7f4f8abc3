"""Solve a force problem: pick a backend, certify what it says, hand on to another where the proof does not stand.

Without a name the structured kernel is asked first, and Clarabel where the problem has not its structure.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from graspforce.backends import clarabel, proxqp, qpsolvers, structured
from graspforce.certificate import TIGHT, certify, judged, refute
from graspforce.errors import BackendError, UnknownName
from graspforce.infeasibility import describe, prove, remedies
from graspforce.problem import ForceProblem
from graspforce.solution import Solution, Status

Backend = Callable[[ForceProblem, "Solution | None"], Solution]

_FALLBACK = "clarabel"


def solvers() -> tuple[str, ...]:
    """The names that ``backend`` may say on this machine."""
    own = ("structured",) if structured.available() else ()
    return (*own, "clarabel", "proxqp", *(name for name in qpsolvers.available() if name not in ("clarabel", "proxqp")))


def solve(problem: ForceProblem, backend: str | None = None, *, explain: bool = True) -> Solution:
    """The contact forces that hold the object at least cost, proven.

    min cost(f) subject to G f = w, friction cones, normal-force and torque limits (`ForceProblem`). The answer is certified
    before it returns: nothing unverified is called optimal or infeasible. Where a backend's answer cannot be verified the
    problem goes to Clarabel, and `Solution.backend` says whose answer it is.

    Args:
        problem: what to solve.
        backend: a name of `solvers()`; by default the structured kernel, or Clarabel where the problem
            is not for it.
        explain: where there is no answer, also work out which friction, which torque limits and which nearest wrench would
            give one; takes some ten times as long as the answer itself.

    Returns:
        The solution: optimal, inaccurate, infeasible (with the proof) or failed.

    Raises:
        UnknownName: no backend of that name is installed.
        BackendError: the named backend cannot take such a problem.
    """
    return _solve(problem, backend, None, explain)


class Solver:
    """A force problem that is solved again and again with numbers that change a little; it keeps the last answer.

    Args:
        problem: the first problem; what later calls do not name stays as it is here.
        backend: a name of `solvers()`; by default as in `solve`.
        explain: as in `solve`.
    """

    def __init__(self, problem: ForceProblem, backend: str | None = None, *, explain: bool = True) -> None:
        self.problem = problem
        self._backend = backend
        self._explain = explain
        self._last: Solution | None = None
        if backend is not None:
            _named(backend)

    def solve(
        self, *, w: Any = None, J: Any = None, tau_u: Any = None, mu: Any = None, p: Any = None, R: Any = None
    ) -> Solution:
        """The answer with the named numbers changed; they stay changed. Arguments as in `ForceProblem.replace`."""
        self.problem = self.problem.replace(w=w, J=J, tau_u=tau_u, mu=mu, p=p, R=R)
        answer = _solve(self.problem, self._backend, self._last, self._explain)
        self._last = answer if answer.found else None
        return answer


@np.errstate(all="ignore")  # what overflows cannot be certified, and is not handed out
def _solve(problem: ForceProblem, backend: str | None, previous: Solution | None, explain: bool) -> Solution:
    first = _default(problem, previous) if backend is None else _named(backend)(problem, previous)
    answer = _certified(problem, first)
    if not _settled(answer) and answer.backend != _FALLBACK:
        second = _certified(problem, clarabel.solve(problem))
        answer = second if _settled(second) or not answer.found else answer
    if not _settled(answer) and not answer.found:
        answer = _with_proof(problem, answer)
    if answer.status is Status.INFEASIBLE and explain:
        answer = _with_proof(problem, answer)
        assert answer.infeasibility is not None  # every certified proof is described
        better = remedies(problem, answer.infeasibility, clarabel.solve_program)
        answer = dataclasses.replace(answer, infeasibility=better)
    return answer


def _with_proof(problem: ForceProblem, answer: Solution) -> Solution:
    """The answer with the tightest proof that there is none; unchanged where that does not stand."""
    proof = prove(problem, clarabel.solve_program)
    if proof is None:
        return answer
    refuted = _certified(problem, dataclasses.replace(answer, status=Status.INFEASIBLE, multipliers=proof))
    return refuted if refuted.status is Status.INFEASIBLE else answer


def _settled(answer: Solution) -> bool:
    """Whether nobody else could do better: proven optimal, or proven infeasible."""
    return answer.status in (Status.OPTIMAL, Status.INFEASIBLE)


def _default(problem: ForceProblem, previous: Solution | None) -> Solution:
    """The structured kernel's answer, or Clarabel's where the kernel does not take the problem."""
    if not structured.available():
        _say_once_that_there_is_no_kernel()
        return clarabel.solve(problem)
    try:
        return structured.solve(problem, previous)
    except BackendError:
        return clarabel.solve(problem)


@cache
def _say_once_that_there_is_no_kernel() -> None:
    said = "graspforce was installed without a C compiler: Clarabel solves in the structured kernel's place, and takes longer"
    warnings.warn(said, RuntimeWarning, stacklevel=5)


def _named(backend: str) -> Backend:
    if backend == "structured" and structured.available():
        return structured.solve
    if backend == "clarabel":
        return clarabel.solve
    if backend == "proxqp":
        return proxqp.solve
    if backend in solvers():
        return lambda problem, previous: qpsolvers.solve(problem, previous, solver=backend)
    raise UnknownName("backend", backend, "one of " + ", ".join(solvers()))


def _certified(problem: ForceProblem, answer: Solution) -> Solution:
    """The answer with its certificate, its status what the certificate makes of it."""
    multipliers = answer.multipliers
    if multipliers is None or not (len(answer.f) or answer.status is Status.INFEASIBLE):
        return answer.judged(Status.FAILED, None)
    if answer.status is Status.INFEASIBLE:
        refutation = refute(problem, multipliers)
        if not refutation.certificate.verified:
            return answer.judged(Status.FAILED, None)
        answer = dataclasses.replace(answer, infeasibility=describe(problem, refutation))
        return answer.judged(Status.INFEASIBLE, refutation.certificate)
    certificate = judged(*answer.measured) if answer.measured else certify(problem, answer.f, multipliers)
    if not certificate.verified:
        return answer.judged(Status.FAILED, certificate)
    return answer.judged(Status.OPTIMAL if certificate.tolerance <= TIGHT else Status.INACCURATE, certificate)
