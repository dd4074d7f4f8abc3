"""Blocks of cases, for long races: each block samples every collection evenly, so that a part of the race is a fair sample.

The blocks run one after another, and within a block one solver after another. An interrupted race has results of every solver
on every collection. Sequences stay whole.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby

from graspforce import problems
from graspforce.bench.case_sequences import case_groups
from graspforce.bench.outcome import RaceTask
from graspforce.core.errors import InvalidInput

BLOCKS = 60


def case_blocks() -> dict[str, int]:
    """Return the block of each case of the library, from 0 to `BLOCKS` − 1."""
    groups = [group for collection in problems.collections() for group in case_groups(collection)]
    return {name: i % BLOCKS for i, group in enumerate(groups) for name in group}


def order_in_blocks(tasks: Iterable[RaceTask]) -> list[RaceTask]:
    """Return tasks by block, then by solver in the order of their first task.

    Args:
        tasks: the tasks.
    """
    given, blocks = list(tasks), case_blocks()
    solvers = {name: i for i, name in enumerate(dict.fromkeys(task.solver for task in given))}
    return sorted(given, key=lambda task: (blocks[task.case], solvers[task.solver]))


def select_slice(tasks: Sequence[RaceTask], part: int, parts: int) -> list[RaceTask]:
    """Return the tasks of one of several slices; a slice holds whole blocks.

    Args:
        tasks: the tasks.
        part: number of the slice, from 1.
        parts: number of slices.

    Raises:
        InvalidInput: there is no such slice.
    """
    if not 1 <= parts <= BLOCKS:
        raise InvalidInput("slice", f"{part}/{parts}", f"K/N with N from 1 to {BLOCKS}")
    if not 1 <= part <= parts:
        raise InvalidInput("slice", f"{part}/{parts}", f"K/N with K from 1 to {parts}")
    blocks = case_blocks()
    return [task for task in tasks if blocks[task.case] % parts == part - 1]


def task_units(tasks: Sequence[RaceTask], blocks: Mapping[str, int] | None = None) -> list[tuple[RaceTask, ...]]:
    """Return the runs of consecutive tasks with one solver in one block, which run in order in one process.

    Args:
        tasks: the tasks, in order.
        blocks: blocks of the cases; those of `case_blocks` by default.
    """
    known = case_blocks() if blocks is None else blocks
    return [tuple(own) for _, own in groupby(tasks, key=lambda task: (known[task.case], task.solver))]
