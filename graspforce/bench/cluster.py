"""Run the tasks of a race on a Dask cluster: each solver still runs in a process of its own, which the Dask worker starts.

All workers need the same machine and the same versions, so that times and verdicts are comparable. Races of other machines go
to other files, which merge. Workers need one thread. A nanny prevents workers from starting processes: use ``--no-nanny``.
"""

from __future__ import annotations

import multiprocessing
import platform
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

from graspforce.analysis.cluster import run_on_cluster
from graspforce.bench.conditions import race_conditions
from graspforce.bench.outcome import RaceOutcome, RaceTask
from graspforce.bench.worker import Worker
from graspforce.core.errors import BackendError

_TASKS_PER_BATCH = 20  # few enough that a dead worker loses seconds of work


def conditions_on_cluster(solvers: Sequence[str], limit: float, cluster: Any) -> dict[str, Any]:
    """Return the conditions of a race on a cluster, from one of its workers.

    Args:
        solvers: names of the solvers.
        limit: processor time of one solve, s.
        cluster: address of a Dask scheduler, or a cluster of Dask.

    Raises:
        BackendError: the cluster cannot be reached.
    """
    return dict(next(run_on_cluster(cluster, race_conditions, [(solvers, limit)])))


def run_tasks_on_cluster(
    tasks: Sequence[RaceTask], limit: float, cluster: Any, facts: Mapping[str, Any]
) -> Iterator[RaceOutcome]:
    """Yield the outcomes of tasks in the order in which they arrive.

    Args:
        tasks: the tasks; those of one solver follow one another.
        limit: processor time of one solve, s.
        cluster: address of a Dask scheduler, or a cluster of Dask.
        facts: conditions of the race, as `conditions_on_cluster` returns them.

    Raises:
        BackendError: the cluster cannot be reached, its workers cannot start processes, or their conditions are not those.
    """
    batches = []
    for _, own in groupby(tasks, key=lambda task: task.solver):
        same = tuple(own)
        batches += [(same[i : i + _TASKS_PER_BATCH], limit, facts) for i in range(0, len(same), _TASKS_PER_BATCH)]
    for outcomes in run_on_cluster(cluster, run_batch, batches):
        yield from outcomes


def run_batch(tasks: Sequence[RaceTask], limit: float, facts: Mapping[str, Any]) -> list[RaceOutcome]:
    """Return the outcomes of some tasks, on a worker of Dask.

    Args:
        tasks: the tasks.
        limit: processor time of one solve, s.
        facts: conditions of the race.

    Raises:
        BackendError: this process cannot start processes, or its conditions are not those of the race.
    """
    if multiprocessing.current_process().daemon:
        raise BackendError("a Dask worker under a nanny cannot start solvers: start workers with --no-nanny")
    own = race_conditions(tuple(dict.fromkeys(task.solver for task in tasks)), limit)
    wanted = {**facts, "versions": {name: facts["versions"].get(name) for name in own["versions"]}}
    if different := [name for name, value in own.items() if value != wanted[name]]:
        name = different[0]
        message = f"worker {platform.node()} has other {name} than the race: {own[name]} instead of {wanted[name]}"
        raise BackendError(f"{message}; run one race per kind of machine, and merge their files")
    with Worker(limit) as worker:
        return [worker.run(task) for task in tasks]
