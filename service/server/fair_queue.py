"""Queues with threads behind them: where requests wait between the network's thread and the work."""

from __future__ import annotations

import logging
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

log = logging.getLogger("graspforce.service")


class FairQueue(Generic[T]):
    """A bounded queue and the threads that take from it: one item of everybody who waits, in turn, each one's in their order.

    Args:
        name: of the threads.
        work: what is done with an item.
        threads: how many do it at once.
        room: how many items may wait; None for any number.
    """

    def __init__(self, name: str, work: Callable[[T], None], *, threads: int = 1, capacity: int | None = None) -> None:
        self._work, self._capacity = work, capacity
        self._waiting: OrderedDict[bytes, deque[T]] = OrderedDict()  # by who asks, whose turn it is first; nobody's is empty
        self._count, self._closing = 0, False
        self._changed = threading.Condition()
        self._threads = [threading.Thread(target=self._run, name=f"{name}-{i}", daemon=True) for i in range(threads)]
        for thread in self._threads:
            thread.start()

    def offer(self, item: T, client: bytes = b"") -> T | None:
        """Take an item in, at once and without waiting for room.

        Args:
            item: what to work on.
            who: asks for it: what others have waiting does not keep it from its turn.

        Returns:
            The item for which there is no room: the newest of whoever has most waiting. None where there is room for all.
        """
        with self._changed:
            rejected = None
            if self._capacity is not None and self._count >= self._capacity:
                longest = max(self._waiting.values(), key=len, default=deque[T]())
                if len(longest) <= len(self._waiting.get(client, ())) + 1:
                    return item
                rejected = longest.pop()
                self._count -= 1
            self._waiting.setdefault(client, deque()).append(item)
            self._count += 1
            self._changed.notify()
            return rejected

    def __len__(self) -> int:
        return self._count

    def close(self, deadline: float) -> list[T]:
        """Finish what waits, until a time on the clock `time.monotonic`, s; returns what was not begun by then."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join(max(deadline - time.monotonic(), 0.0))
        return self.take_all()

    def take_all(self) -> list[T]:
        """What waits, taken out without being worked on."""
        with self._changed:
            left = [item for items in self._waiting.values() for item in items]
            self._waiting.clear()
            self._count = 0
        return left

    def _next(self) -> T | None:
        """The next item; None where the lane closes and nothing waits."""
        with self._changed:
            while not self._waiting and not self._closing:
                self._changed.wait()
            if not self._waiting:
                return None
            client, items = self._waiting.popitem(last=False)
            if len(items) > 1:
                self._waiting[client] = items  # at the end of the round
            self._count -= 1
            return items.popleft()

    def _run(self) -> None:
        while (item := self._next()) is not None:
            try:
                self._work(item)
            except Exception:
                log.exception("a request could not be answered")
            del item  # a request must not outlive its answer while this thread waits for the next one
