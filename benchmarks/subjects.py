"""Subjects of `python -m benchmarks`: each solves a problem, cold or warm.

A raw subject is only the call of a solver on arrays built beforehand. The other subjects are whole calls of this package, with
certificate and record. The solutions of raw subjects are certified outside the timed part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import clarabel
import daqp
import numpy as np
import quadprog
from proxsuite import proxqp
from scipy import sparse

from graspforce import Cone, ForceProblem, Solver, solve
from graspforce.force.backends import compiled_kernel
from graspforce.force.certificate import LOOSE_TOLERANCE, certify
from graspforce.force.cone_program import ConicProgram, conic_program

PEER = "raw Clarabel, set-up + solve"
KERNEL_COLD, KERNEL_WARM = "structured kernel alone, cold", "structured kernel alone, warm"
SOLVER_COLD, SOLVER_WARM = "Solver, cold: set-up + first step", "Solver, warm: w, J, tau_u"
WHOLE = "solve(problem)"
_RIDGE = 1e-10  # in units of the cost, for solvers that need a positive definite Hessian
_MAX_PYRAMID_CONTACTS = 50  # above it, active-set solvers take seconds per problem


@dataclass(frozen=True, eq=False, slots=True)
class Subject:
    """A subject of the benchmark.

    Args:
        name: name in the table.
        run: timed solve of the i-th nearby problem.
        is_certified: whether the output of `run` for the i-th problem is a certified solution; not timed.
        iterations: number of iterations in the output of `run`.
    """

    name: str
    run: Callable[[int], Any]
    is_certified: Callable[[int, Any], bool]
    iterations: Callable[[Any], int]


def subjects(problem: ForceProblem, nearby: Sequence[ForceProblem]) -> Iterator[Subject]:
    """Yield all subjects. Warm subjects start from the problem and solve the nearby problems in sequence.

    Args:
        problem: a feasible problem with exact cones.
        nearby: the problem with wrench, Jacobian and bias torques changed by up to 1 %.
    """
    yield _clarabel_cold(nearby)
    yield _clarabel_update(problem, nearby)
    yield _kernel(KERNEL_COLD, problem, nearby, warm=False)
    yield _kernel(KERNEL_WARM, problem, nearby, warm=True)
    yield Subject(SOLVER_COLD, lambda i: Solver(nearby[i]).solve(), _certified, _iterations)
    yield _solver("Solver, warm: w", problem, [_numbers(one, "w") for one in nearby])
    yield _solver(SOLVER_WARM, problem, [_numbers(one, "w", "J", "tau_u") for one in nearby])
    yield _solver("Solver, warm: w, J, tau_u, p, R", problem, [_numbers(one, "w", "J", "tau_u", "p", "R") for one in nearby])
    yield Subject(WHOLE, lambda i: solve(nearby[i], explain=False), _certified, _iterations)
    if len(problem.contacts) <= _MAX_PYRAMID_CONTACTS:
        for facets in (4, 8):
            yield from _pyramid_subjects(problem, nearby, facets)


def _solver(name: str, problem: ForceProblem, steps: Sequence[dict[str, Any]]) -> Subject:
    """Return a subject whose solver has solved the problem and then solves the steps in sequence."""
    solver = Solver(problem)
    solver.solve()
    return Subject(name, lambda i: solver.solve(**steps[i]), _certified, _iterations)


def _numbers(problem: ForceProblem, *names: str) -> dict[str, Any]:
    actuation, contacts = problem.actuation, problem.contacts
    assert actuation is not None  # random_problem sets it
    known = {"w": problem.w, "J": actuation.J, "tau_u": actuation.tau_u, "p": contacts.p_OC, "R": contacts.R_OC}
    return {name: known[name] for name in names}


def _certified(_: int, solution: Any) -> bool:
    return bool(solution.found and solution.backend == "structured")


def _iterations(solution: Any) -> int:
    return int(solution.iterations)


def _clarabel_arrays(program: ConicProgram) -> tuple[Any, Any, Any, Any, list[Any]]:
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


def _clarabel_certified(nearby: Sequence[ForceProblem], programs: Sequence[ConicProgram]) -> Callable[[int, Any], bool]:
    def is_certified(i: int, answer: Any) -> bool:
        program = programs[i]
        e, rows = len(program.b), len(program.d)
        z = np.array(answer.z)
        multipliers = program.multipliers(-z[:e], np.maximum(z[e : e + rows], 0.0))
        return certify(nearby[i], program.forces(np.array(answer.x)), multipliers).verified

    return is_certified


def _clarabel_cold(nearby: Sequence[ForceProblem]) -> Subject:
    programs = [conic_program(one) for one in nearby]
    data, settings = [_clarabel_arrays(program) for program in programs], _clarabel_settings()

    def run(i: int) -> Any:
        return clarabel.DefaultSolver(*data[i], settings).solve()

    return Subject(PEER, run, _clarabel_certified(nearby, programs), lambda answer: int(answer.iterations))


def _clarabel_update(problem: ForceProblem, nearby: Sequence[ForceProblem]) -> Subject:
    programs = [conic_program(one) for one in nearby]
    solver = clarabel.DefaultSolver(*_clarabel_arrays(conic_program(problem)), _clarabel_settings())
    solver.solve()
    data = [_clarabel_arrays(program) for program in programs]

    def run(i: int) -> Any:
        P, q, A, b, _ = data[i]
        solver.update(P=P, q=q, A=A, b=b)
        return solver.solve()

    is_certified = _clarabel_certified(nearby, programs)
    return Subject("raw Clarabel, update + solve", run, is_certified, lambda answer: int(answer.iterations))


def _kernel(name: str, problem: ForceProblem, nearby: Sequence[ForceProblem], *, warm: bool) -> Subject:
    """Return the kernel alone: each nearby problem is in the arrays of a kernel that has solved the problem itself."""
    arrays = [compiled_kernel.kernel_arrays(problem) for _ in nearby]
    for own in arrays:
        own.update({field: numbers.copy() for field, numbers in _numbers(problem, "w", "J", "tau_u").items()})
    kernels = [compiled_kernel.Kernel(**own) for own in arrays]
    for kernel, own, one in zip(kernels, arrays, nearby, strict=True):
        kernel.solve(0, 1, 1e-9, 60, False)
        for field, numbers in _numbers(one, "w", "J", "tau_u").items():
            own[field][:] = numbers

    def run(i: int) -> int:
        return kernels[i].solve(0, 1, 1e-9, 60, warm)

    def is_certified(i: int, status: int) -> bool:
        kernels[i].certify(0, 1)
        report = arrays[i]["report"][0]
        residuals = [report[name] for name in ("certified_primal", "certified_dual", "certified_gap")]
        return status <= 1 and bool(max(residuals) <= LOOSE_TOLERANCE)

    return Subject(name, run, is_certified, lambda status: int(arrays[0]["report"]["iterations"][0]))


def _pyramid_subjects(problem: ForceProblem, nearby: Sequence[ForceProblem], facets: int) -> Iterator[Subject]:
    """Yield raw quadratic-programming solvers on the inner pyramid, which admits fewer forces."""
    cone = Cone("pyramid", facets, "inner")
    pyramids = [ForceProblem(p.contacts, p.w, p.actuation, cone, p.objective) for p in (problem, *nearby)]
    before, *programs = [conic_program(one) for one in pyramids]
    m, e, rows = len(before.q), len(before.b), len(before.d)
    unbounded = np.full(rows, -1e20)

    def is_certified(i: int, x: Any, y: Any, z: Any) -> bool:
        program = programs[i]
        multipliers = program.multipliers(np.array(y), np.maximum(z, 0.0))
        return certify(pyramids[i + 1], program.forces(np.array(x)), multipliers).verified

    qp = proxqp.dense.QP(m, e, rows)
    qp.settings.eps_abs, qp.settings.eps_rel, qp.settings.max_iter = 1e-9, 0.0, 200
    qp.settings.initial_guess = proxqp.InitialGuess.WARM_START
    qp.init(before.P, before.q, before.A, before.b, before.C, unbounded, before.d)
    qp.solve()

    def warm(i: int) -> Any:
        start = (qp.results.x, qp.results.y, qp.results.z)
        program = programs[i]
        qp.update(program.P, program.q, program.A, program.b, program.C, unbounded, program.d)
        qp.solve(*start)
        return qp.results

    def warm_certified(i: int, results: Any) -> bool:
        return is_certified(i, results.x, -results.y, results.z)

    yield Subject(f"raw ProxQP, warm, {facets} facets", warm, warm_certified, lambda results: int(results.info.iter))

    ridged = [program.P + _RIDGE * np.eye(m) for program in programs]
    stacked = [np.ascontiguousarray(np.vstack([program.A, program.C])) for program in programs]
    upper = [np.concatenate([program.b, program.d]) for program in programs]
    lower = [np.concatenate([program.b, unbounded]) for program in programs]
    sense = np.array([5] * e + [0] * rows, dtype=np.intc)  # 5: equality

    def active_set(i: int) -> Any:
        problem = (ridged[i], programs[i].q, stacked[i], upper[i], lower[i], sense)
        return daqp.solve(*problem, primal_tol=1e-9, dual_tol=1e-9)

    def active_set_certified(i: int, answer: Any) -> bool:
        x, _, flag, info = answer
        multipliers = np.asarray(info["lam"])
        return flag > 0 and is_certified(i, x, -multipliers[:e], multipliers[e:])

    yield Subject(f"raw DAQP, {facets} facets", active_set, active_set_certified, lambda answer: int(answer[3]["iterations"]))

    columns = [np.ascontiguousarray(np.vstack([program.A, -program.C]).T) for program in programs]
    right = [np.concatenate([program.b, -program.d]) for program in programs]

    def goldfarb_idnani(i: int) -> Any:
        return quadprog.solve_qp(ridged[i], -programs[i].q, columns[i], right[i], e)

    def goldfarb_idnani_certified(i: int, answer: Any) -> bool:
        multipliers = np.asarray(answer[4])
        return is_certified(i, answer[0], multipliers[:e], multipliers[e:])

    yield Subject(
        f"raw quadprog, {facets} facets", goldfarb_idnani, goldfarb_idnani_certified, lambda answer: int(answer[3][0])
    )
