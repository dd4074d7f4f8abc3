"""Run a function for many arguments on a Dask cluster (extra ``cluster``), with a bounded number of tasks in flight.

Dask runs the tasks of a dead worker again on another one. A task must therefore give the same result when it runs twice.

A task uses one thread of linear algebra: workers on the same machine would otherwise compete for its cores.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from graspforce.core.errors import BackendError
from graspforce.core.optional_libraries import optional_imports

_TASKS_PER_THREAD = 2  # one that runs, and one that waits at the worker
_CONNECTION_LIMIT = 30.0  # s


def run_on_cluster(cluster: Any, function: Callable[..., Any], arguments: Iterable[tuple[Any, ...]]) -> Iterator[Any]:
    """Yield the results of a function in the order in which they arrive.

    Args:
        cluster: address of a Dask scheduler, such as "tcp://host:8786", or a cluster of Dask such as ``SLURMCluster``.
        function: the function; workers import it.
        arguments: positional arguments of each call; read as results arrive.

    Raises:
        MissingLibrary: distributed is not installed.
        BackendError: the scheduler cannot be reached, or a task ended several workers.
    """
    with optional_imports():
        import distributed
    try:
        client = distributed.Client(cluster, timeout=_CONNECTION_LIMIT, set_as_default=False)
    except OSError as error:
        raise BackendError(f"no Dask scheduler answers at {cluster}: {error}") from None
    remaining = iter(arguments)
    with client, client.as_current():
        client.wait_for_workers(1)
        pending = distributed.as_completed()

        def submit() -> None:
            """Submit tasks until each thread has its share. Workers may have joined or left meanwhile."""
            running = pending.count()
            count = _TASKS_PER_THREAD * sum(client.nthreads().values()) - running
            for each in itertools.islice(remaining, max(count, 0 if running else 1)):  # one, even if all workers are gone
                pending.add(client.submit(_call_with_one_thread, function, *each, pure=False))

        submit()
        for future in pending:
            try:
                result = future.result()
            except distributed.scheduler.KilledWorker as error:
                raise BackendError(f"a task ended several workers: {error}") from None
            future.release()
            submit()
            yield result


def _call_with_one_thread(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return the result of a function that uses one thread of linear algebra."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):
        return function(*arguments)
