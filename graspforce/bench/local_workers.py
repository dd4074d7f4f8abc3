"""Run the tasks of a race on this machine, several at once. Each solver runs in processes of its own, which are kept."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack

from graspforce.bench.blocks import task_units
from graspforce.bench.outcome import RaceOutcome, RaceTask
from graspforce.bench.worker import Worker


def run_tasks_here(
    tasks: Sequence[RaceTask], limit: float, workers: int = 1, stop: Callable[[], bool] = lambda: False
) -> Iterator[RaceOutcome]:
    """Yield the outcomes of tasks in the order in which they arrive; with one worker, in the order of the tasks.

    Args:
        tasks: the tasks; those of one solver and block follow one another.
        limit: processor time of one solve, s.
        workers: number of tasks that run at once, ≥ 1.
        stop: function that tells whether to start no further task.
    """
    units, lock = iter(task_units(tasks)), threading.Lock()
    arrived: queue.SimpleQueue[RaceOutcome | BaseException | None] = queue.SimpleQueue()

    def next_unit() -> tuple[RaceTask, ...]:
        with lock:
            return next(units, ())

    def run_units() -> None:
        try:
            with ExitStack() as stack:
                kept: dict[str, Worker] = {}
                while unit := next_unit():
                    if unit[0].solver not in kept:
                        kept[unit[0].solver] = stack.enter_context(Worker(limit))
                    for task in unit:
                        if stop() or ended.is_set():
                            return
                        arrived.put(kept[task.solver].run(task))
        except BaseException as error:  # raised again by the caller's thread
            arrived.put(error)
        finally:
            arrived.put(None)

    ended = threading.Event()
    threads = [threading.Thread(target=run_units, daemon=True) for _ in range(workers)]
    for thread in threads:
        thread.start()
    try:
        running = len(threads)
        while running:
            item = arrived.get()
            if isinstance(item, BaseException):
                raise item
            if item is None:
                running -= 1
            else:
                yield item
    finally:
        ended.set()  # the caller has ended early: the threads end after their present task
        for thread in threads:
            thread.join()
