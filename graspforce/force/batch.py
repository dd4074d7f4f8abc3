"""Many force problems at once, on all cores: as problems, or as arrays stacked over one of them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.backends import structured
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import TIGHT_TOLERANCE, Solution, Status
from graspforce.force.solver import solve

_CHUNK = 256  # largest number of problems in one task of a thread pool; amortises the cost of a task
_CHUNKS_PER_THREAD = 8  # fewer leave threads idle at the end, since some problems take longer


@dataclass(frozen=True, eq=False, slots=True)
class StackedSolutions:
    """The answers to stacked problems, as arrays; NaN where there are no forces.

    Args:
        status: one status a problem.
        f: (M, k) stacked contact forces, contact frames, N and N·m.
        torques: (M, n) motor torques, N·m.
        residuals: (M, 3) the certificates' primal and dual residual and gap.
    """

    status: tuple[Status, ...]
    f: Array
    torques: Array
    residuals: Array


def solve_batch(problems: Sequence[ForceProblem], backend: str | None = None, *, explain: bool = False) -> tuple[Solution, ...]:
    """The answers to many problems, in order, each as `solve` gives it; one that has none spoils no other.

    Args:
        problems: any force problems.
        backend, explain: as in `solve`.

    Raises:
        UnknownName, BackendError: as in `solve`, for the backend.
    """
    threads = _core_count()
    size = min(max(len(problems) // (_CHUNKS_PER_THREAD * threads), 1), _CHUNK)

    def solve_chunk(first: int) -> list[Solution]:
        return [solve(problem, backend, explain=explain) for problem in problems[first : first + size]]

    with ThreadPoolExecutor(threads) as pool:
        chunks = pool.map(solve_chunk, range(0, len(problems), size))
        return tuple(solution for chunk in chunks for solution in chunk)


def solve_stack(
    problem: ForceProblem, *, w: Any = None, J: Any = None, tau_u: Any = None, threads: int | None = None
) -> StackedSolutions:
    """The answers to M problems that differ from one only in the arrays given, by the structured kernel, on all cores.

    What the kernel does not prove to `TIGHT_TOLERANCE` goes through `solve`.

    Args:
        problem: what all share, with exact cones.
        w: (M, 6) wrenches, N and N·m.
        J: (M, k, n) hand Jacobians, m/rad.
        tau_u: (M, n) bias torques, N·m.
        threads: how many work at once; by default one a core.

    Raises:
        InvalidInput: arrays of other shapes, none at all, a hand's numbers without a hand, or pyramids.
        BackendError: the structured kernel does not take such a problem.
    """
    rows = _stacked_arrays(problem, {"w": w, "J": J, "tau_u": tau_u})
    count = len(next(iter(rows.values())))

    def solve_chunk(first: int) -> tuple[Array, Array, npt.NDArray[np.void]]:
        last = min(first + _CHUNK, count)
        return structured.solve_stacked(problem, {name: array[first:last] for name, array in rows.items()}, last - first)

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


def _stacked_arrays(problem: ForceProblem, given: dict[str, Any]) -> dict[str, npt.NDArray[np.float64]]:
    """The stacked arrays that were given, of one length."""
    if problem.cone.type != "exact":
        raise InvalidInput("cone.type", problem.cone.type, "exact: stacked problems are certified on exact cones alone")
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
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
