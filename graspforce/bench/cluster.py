"""Run the tasks of a race on a Dask cluster: each solver still runs in a process of its own, which the Dask worker starts.

Times are comparable only if the machines are equal and a worker has one thread. Workers of Dask under a nanny cannot start
processes; start them with ``--no-nanny``.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

from graspforce.analysis.cluster import run_on_cluster
from graspforce.bench.outcome import RaceOutcome, RaceTask
from graspforce.bench.worker import Worker
from graspforce.core.errors import BackendError

_TASKS_PER_BATCH = 20  # few enough that a dead worker loses seconds of work


def run_tasks_on_cluster(tasks: Sequence[RaceTask], limit: float, cluster: Any) -> Iterator[RaceOutcome]:
    """Yield the outcomes of tasks in the order in which they arrive.

    Args:
        tasks: the tasks; those of one solver follow one another.
        limit: processor time of one solve, s.
        cluster: address of a Dask scheduler, or a cluster of Dask.

    Raises:
        BackendError: the cluster cannot be reached, or its workers cannot start processes.
    """
    batches = []
    for _, own in groupby(tasks, key=lambda task: task.solver):
        same = tuple(own)
        batches += [(same[i : i + _TASKS_PER_BATCH], limit) for i in range(0, len(same), _TASKS_PER_BATCH)]
    for outcomes in run_on_cluster(cluster, run_batch, batches):
        yield from outcomes


def run_batch(tasks: Sequence[RaceTask], limit: float) -> list[RaceOutcome]:
    """Return the outcomes of some tasks, on a worker of Dask.

    Args:
        tasks: the tasks.
        limit: processor time of one solve, s.

    Raises:
        BackendError: this process cannot start processes.
    """
    if multiprocessing.current_process().daemon:
        raise BackendError("a Dask worker under a nanny cannot start solvers: start workers with --no-nanny")
    with Worker(limit) as worker:
        return [worker.run(task) for task in tasks]
