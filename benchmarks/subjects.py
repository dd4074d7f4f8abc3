"""What is timed: each subject solves one problem, cold or warm, and says whether its answer stands.

A raw subject is a solver called on arrays that are already built, and nothing else; the others are this package's own calls
with all that belongs to them. Whether a raw answer stands is found out beside the clock, by the certificate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import clarabel
import daqp
import numpy as np
import quadprog
from proxsuite import proxqp
from scipy import sparse

from graspforce import Cone, ForceProblem, Solver, solve
from graspforce.backends import structured
from graspforce.certificate import LOOSE, certify
from graspforce.program import ConicProgram, conic_program

PEER = "raw Clarabel, set-up + solve"
_RIDGE = 1e-10  # of the cost's unit, for solvers that need a positive definite Hessian
_MOST_PYRAMID = 50  # contacts: beyond, the active-set solvers take seconds a problem


@dataclass(frozen=True, eq=False, slots=True)
class Subject:
    """Something to time.

    Args:
        name: as the table says it.
        run: what is timed.
        stands: whether what `run` returned is a certified answer; not timed.
        iterations: of what `run` returned.
    """

    name: str
    run: Callable[[], Any]
    stands: Callable[[Any], bool]
    iterations: Callable[[Any], int]


def subjects(problem: ForceProblem, nearby: ForceProblem) -> Iterator[Subject]:
    """All subjects on a problem; the warm ones start from it and are timed on the one nearby.

    Args:
        problem: a feasible problem with exact cones.
        nearby: the same with wrench and Jacobian changed by up to 1 %.
    """
    yield _clarabel_cold(nearby)
    yield _clarabel_update(problem, nearby)
    yield _kernel("structured kernel alone, cold", problem, nearby, warm=False)
    yield _kernel("structured kernel alone, warm", problem, nearby, warm=True)
    cold = Solver(nearby)
    yield Subject("Solver, first step", cold.solve, _certified, _steps)
    warm = Solver(problem)
    warm.solve()
    change = {"w": nearby.w, "J": nearby.hand.J if nearby.hand else None}
    yield Subject("Solver, warm, w and J changed by 1 %", lambda: warm.solve(**change), _certified, _steps)
    load = Solver(problem)
    load.solve()
    yield Subject("Solver, warm, w changed by 1 %", lambda: load.solve(w=nearby.w), lambda answer: answer.found, _steps)
    yield Subject("solve(problem)", lambda: solve(nearby, explain=False), _certified, _steps)
    if len(problem.contacts) <= _MOST_PYRAMID:
        for facets in (4, 8):
            yield from _on_pyramid(problem, nearby, facets)


def _certified(answer: Any) -> bool:
    return bool(answer.found and answer.backend == "structured")


def _steps(answer: Any) -> int:
    return int(answer.iterations)


def _stack(program: ConicProgram) -> tuple[Any, Any, Any, Any, list[Any]]:
    rows = sparse.csc_matrix(np.vstack([program.A, program.C, program.S]))
    cones = [clarabel.ZeroConeT(len(program.b)), clarabel.NonnegativeConeT(len(program.d))]
    cones += [clarabel.SecondOrderConeT(size) for size in program.cones]
    right = np.concatenate([program.b, program.d, program.r])
    return sparse.csc_matrix(np.triu(program.P)), program.q, rows, right, cones


def _clarabel_settings() -> Any:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-9
    settings.presolve_enable = False
    settings.max_threads = 1
    return settings


def _clarabel_stands(problem: ForceProblem, program: ConicProgram) -> Callable[[Any], bool]:
    e, i = len(program.b), len(program.d)

    def stands(answer: Any) -> bool:
        z = np.array(answer.z)
        multipliers = program.multipliers(-z[:e], np.maximum(z[e : e + i], 0.0))
        return certify(problem, program.forces(np.array(answer.x)), multipliers).verified

    return stands


def _clarabel_cold(problem: ForceProblem) -> Subject:
    program = conic_program(problem)
    data, settings = _stack(program), _clarabel_settings()
    run = lambda: clarabel.DefaultSolver(*data, settings).solve()  # noqa: E731
    return Subject(PEER, run, _clarabel_stands(problem, program), lambda answer: int(answer.iterations))


def _clarabel_update(problem: ForceProblem, nearby: ForceProblem) -> Subject:
    """Update takes new numbers in the old pattern: zeros that stand for nothing are kept in both."""
    first, second = conic_program(problem), conic_program(nearby)
    P, q, A, b, cones = _stack(first)
    solver = clarabel.DefaultSolver(P, q, A, b, cones, _clarabel_settings())
    solver.solve()
    P2, q2, A2, b2, _ = _stack(second)

    def run() -> Any:
        solver.update(P=P2, q=q2, A=A2, b=b2)
        return solver.solve()

    return Subject("raw Clarabel, update + solve", run, _clarabel_stands(nearby, second), lambda answer: int(answer.iterations))


def _kernel(name: str, problem: ForceProblem, nearby: ForceProblem, *, warm: bool) -> Subject:
    bound = structured.solve(problem).restart
    bound.load(nearby)

    def stands(status: int) -> bool:
        bound._kernel.certify(0, 1)
        return status <= 1 and bool(bound._report[5:].max() <= LOOSE)

    solve_once = bound._kernel.solve
    return Subject(name, lambda: solve_once(0, 1, 1e-9, 60, warm), stands, lambda status: int(bound._report[1]))


def _on_pyramid(problem: ForceProblem, nearby: ForceProblem, facets: int) -> Iterator[Subject]:
    """Raw quadratic-programming solvers on the inner pyramid: another, smaller set of forces."""
    cone = Cone("pyramid", facets, "inner")
    first, last = (ForceProblem(p.contacts, p.w, p.hand, cone, p.objective) for p in (problem, nearby))
    before, program = conic_program(first), conic_program(last)
    m, e, i = len(program.q), len(program.b), len(program.d)
    unbounded = np.full(i, -1e20)

    def stands(x: Any, y: Any, z: Any) -> bool:
        return certify(last, program.forces(np.array(x)), program.multipliers(np.array(y), np.maximum(z, 0.0))).verified

    qp = proxqp.dense.QP(m, e, i)
    qp.settings.eps_abs, qp.settings.eps_rel, qp.settings.max_iter = 1e-9, 0.0, 200
    qp.settings.initial_guess = proxqp.InitialGuess.WARM_START
    qp.init(before.P, before.q, before.A, before.b, before.C, unbounded, before.d)
    qp.solve()
    start = tuple(np.array(part) for part in (qp.results.x, qp.results.y, qp.results.z))

    def warm() -> Any:
        qp.update(program.P, program.q, program.A, program.b, program.C, unbounded, program.d)
        qp.solve(*start)
        return qp.results

    yield Subject(f"raw ProxQP, warm, {facets} facets", warm, lambda r: stands(r.x, -r.y, r.z), lambda r: int(r.info.iter))
    ridged = program.P + _RIDGE * np.eye(m)
    rows = np.ascontiguousarray(np.vstack([program.A, program.C]))
    upper, lower = np.concatenate([program.b, program.d]), np.concatenate([program.b, unbounded])
    sense = np.array([5] * e + [0] * i, dtype=np.intc)  # 5: an equality that stays active

    def active_set() -> Any:
        return daqp.solve(ridged, program.q, rows, upper, lower, sense, primal_tol=1e-9, dual_tol=1e-9)

    def daqp_stands(answer: Any) -> bool:
        x, _, flag, info = answer
        return flag > 0 and stands(x, -np.asarray(info["lam"])[:e], np.asarray(info["lam"])[e:])

    yield Subject(f"raw DAQP, {facets} facets", active_set, daqp_stands, lambda answer: int(answer[3]["iterations"]))
    constraints = np.ascontiguousarray(np.vstack([program.A, -program.C]).T)
    right = np.concatenate([program.b, -program.d])

    def goldfarb_idnani() -> Any:
        return quadprog.solve_qp(ridged, -program.q, constraints, right, e)

    yield Subject(
        f"raw quadprog, {facets} facets",
        goldfarb_idnani,
        lambda answer: stands(answer[0], np.asarray(answer[4])[:e], np.asarray(answer[4])[e:]),
        lambda answer: int(answer[3][0]),
    )
