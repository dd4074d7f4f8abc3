"""Solve a sequence of force problems on all cores."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from graspforce.force.backends.protocol import SolverSettings
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution
from graspforce.force.solver import solve
from graspforce.force.stack import CHUNK, core_count

_CHUNKS_PER_THREAD = 8  # fewer leave threads idle at the end, since some problems take longer


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
    threads = core_count()
    size = min(max(len(problems) // (_CHUNKS_PER_THREAD * threads), 1), CHUNK)

    def solve_chunk(first: int) -> list[Solution]:
        return [solve(problem, backend, settings=settings, explain=explain) for problem in problems[first : first + size]]

    with ThreadPoolExecutor(threads) as pool:
        chunks = pool.map(solve_chunk, range(0, len(problems), size))
        return tuple(solution for chunk in chunks for solution in chunk)
