"""Queues with threads behind them: where requests wait between the network's thread and the work."""

from __future__ import annotations

import contextlib
import logging
import queue
import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

log = logging.getLogger("graspforce.service")


class Lane(Generic[T]):
    """A bounded queue and the threads that take from it, in order of arrival.

    Args:
        name: of the threads.
        work: what is done with an item.
        threads: how many do it at once.
        room: how many items may wait; None for any number.
    """

    def __init__(self, name: str, work: Callable[[T], None], *, threads: int = 1, room: int | None = None) -> None:
        self._work, self._room = work, room
        self._waiting: queue.SimpleQueue[T | None] = queue.SimpleQueue()
        self._threads = [threading.Thread(target=self._run, name=f"{name}-{i}", daemon=True) for i in range(threads)]
        for thread in self._threads:
            thread.start()

    def offer(self, item: T) -> bool:
        """Take an item in, at once and without blocking; False: there is no room."""
        if self._room is not None and self._waiting.qsize() >= self._room:
            return False
        self._waiting.put(item)
        return True

    def __len__(self) -> int:
        return self._waiting.qsize()

    def close(self, deadline: float) -> list[T]:
        """Finish what waits, until a time on the clock `time.monotonic`, s; returns what was not begun by then."""
        for _ in self._threads:
            self._waiting.put(None)
        for thread in self._threads:
            thread.join(max(deadline - time.monotonic(), 0.0))
        left = self.take_all()
        for _ in self._threads:  # for a thread that is still at work: the end it has not yet seen was just taken out
            self._waiting.put(None)
        return left

    def take_all(self) -> list[T]:
        """What waits, taken out without being worked on."""
        left: list[T] = []
        with contextlib.suppress(queue.Empty):
            while True:
                if (item := self._waiting.get_nowait()) is not None:
                    left.append(item)
        return left

    def _run(self) -> None:
        while (item := self._waiting.get()) is not None:
            try:
                self._work(item)
            except Exception:
                log.exception("a request could not be answered")
            del item  # a request must not outlive its answer while this thread waits for the next one
