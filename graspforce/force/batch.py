"""Solve many force problems on all cores: a sequence of problems, or stacked arrays over one problem."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.backends import compiled_kernel
from graspforce.force.backends.protocol import SolverSettings
from graspforce.force.certificate import TIGHT_TOLERANCE
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution
from graspforce.force.solver import solve
from graspforce.force.status import Status

_CHUNK = 256  # largest number of problems in one task of a thread pool; amortises the cost of a task
_CHUNKS_PER_THREAD = 8  # fewer leave threads idle at the end, since some problems take longer


@dataclass(frozen=True, eq=False, slots=True)
class StackedSolutions:
    """The solutions of M stacked problems, as arrays; rows without forces are NaN.

    Args:
        status: (M) one status per problem.
        f: (M, k) stacked contact forces in the contact frames, N and N·m.
        torques: (M, n) motor torques, N·m.
        residuals: (M, 3) primal residual, dual residual and gap of the certificates, relative.
    """

    status: tuple[Status, ...]
    f: Array
    torques: Array
    residuals: Array


def solve_batch(
    problems: Sequence[ForceProblem],
    backend: str | None = None,
    *,
    settings: SolverSettings | None = None,
    explain: bool = False,
) -> tuple[Solution, ...]:
    """Return the solutions of many problems, in order. An infeasible problem does not affect the others.

    Args:
        problems: the force problems.
        backend: as in `solve`.
        settings: as in `solve`.
        explain: as in `solve`.

    Raises:
        UnknownName: no backend of that name is available.
        UnsupportedProblem: the named backend does not support one of the problems.
    """
    threads = _core_count()
    size = min(max(len(problems) // (_CHUNKS_PER_THREAD * threads), 1), _CHUNK)

    def solve_chunk(first: int) -> list[Solution]:
        return [solve(problem, backend, settings=settings, explain=explain) for problem in problems[first : first + size]]

    with ThreadPoolExecutor(threads) as pool:
        chunks = pool.map(solve_chunk, range(0, len(problems), size))
        return tuple(solution for chunk in chunks for solution in chunk)


def solve_stack(
    problem: ForceProblem,
    *,
    w: npt.ArrayLike | None = None,
    J: npt.ArrayLike | None = None,
    tau_u: npt.ArrayLike | None = None,
    threads: int | None = None,
) -> StackedSolutions:
    """Return the solutions of M problems that differ only in the given arrays, by the structured kernel.

    Problems that the kernel does not certify at `TIGHT_TOLERANCE` are solved again by `solve`.

    Args:
        problem: the common values, with exact cones.
        w: (M, 6) wrenches, in O, N and N·m.
        J: (M, k, n) hand Jacobians, m/rad.
        tau_u: (M, n) motor torques without contact, N·m.
        threads: number of threads; by default one per core.

    Raises:
        InvalidInput: no arrays, wrong shapes, J or tau_u without actuation, or a problem with pyramids or with an uncertainty.
        UnsupportedProblem: the structured kernel does not support the problem.
        BackendError: the structured kernel was not built.
    """
    rows = _stacked_arrays(problem, {"w": w, "J": J, "tau_u": tau_u})
    count = len(next(iter(rows.values())))

    def solve_chunk(first: int) -> tuple[Array, Array, npt.NDArray[np.void]]:
        last = min(first + _CHUNK, count)
        return compiled_kernel.solve_stacked(problem, {name: array[first:last] for name, array in rows.items()}, last - first)

    with ThreadPoolExecutor(threads or _core_count()) as pool:
        parts = list(pool.map(solve_chunk, range(0, count, _CHUNK)))
    f, torques, reports = (np.concatenate(each) for each in zip(*parts, strict=True))
    residuals = np.column_stack([reports[name] for name in ("certified_primal", "certified_dual", "certified_gap")])
    proven = (reports["status"] <= 1) & (residuals.max(axis=1) <= TIGHT_TOLERANCE)
    status = [Status.OPTIMAL] * count
    for i in np.flatnonzero(~proven):
        answer = solve(problem.replace(**{name: array[i] for name, array in rows.items()}), explain=False)
        status[i] = answer.status
        f[i], torques[i] = (answer.f, answer.torques) if answer.found else (np.nan, np.nan)
        known = answer.certificate
        residuals[i] = np.nan if known is None else (known.primal_residual, known.dual_residual, known.gap)
    return StackedSolutions(tuple(status), *(arrays.freeze(part) for part in (f, torques, residuals)))


def _stacked_arrays(problem: ForceProblem, given: dict[str, npt.ArrayLike | None]) -> dict[str, npt.NDArray[np.float64]]:
    """Return the given arrays, checked: of one length, and of the problem's shapes."""
    if problem.uncertainty is not None:
        raise InvalidInput("uncertainty", "given", "absent: stacked problems have exact data")
    if problem.cone.type != "exact":
        raise InvalidInput("cone.type", problem.cone.type, "exact: stacked problems are certified with exact cones only")
    n = 0 if problem.actuation is None else len(problem.actuation.tau_u)
    shapes: dict[str, tuple[int | None, ...]] = {"w": (None, 6), "J": (None, problem.size, n), "tau_u": (None, n)}
    rows = {name: arrays.check_array(value, name, shapes[name]) for name, value in given.items() if value is not None}
    if not rows:
        raise InvalidInput("w", None, "given, or J or tau_u")
    if problem.actuation is None and len(rows) > ("w" in rows):
        raise InvalidInput("hand", None, "given before its jacobian or bias_torque can change")
    lengths = {name: len(array) for name, array in rows.items()}
    if len(set(lengths.values())) > 1 or not min(lengths.values()):
        raise InvalidInput(", ".join(rows), list(lengths.values()), "of one length, at least 1")
    return rows


def _core_count() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
