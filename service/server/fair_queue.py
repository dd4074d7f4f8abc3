"""Fair queues: requests wait here between the network's thread and the threads that answer them.

Clients take turns: the queue serves one item of each waiting client per round, first in, first out within each client. If the
queue is full, the newest item of the busiest client is rejected. A client with many requests therefore delays another client's
request by at most one item per round.
"""

from __future__ import annotations

import logging
import threading
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Generic, TypeVar

from graspforce.service.server.deadline import Deadline

T = TypeVar("T")

log = logging.getLogger("graspforce.service")


class FairQueue(Generic[T]):
    """A bounded queue with its own threads, round-robin between clients.

    Args:
        name: prefix of the threads' names.
        work: function that handles an item.
        threads: number of threads.
        capacity: largest number of waiting items; None for no limit.
    """

    def __init__(self, name: str, work: Callable[[T], None], *, threads: int = 1, capacity: int | None = None) -> None:
        self._work, self._capacity = work, capacity
        self._waiting: OrderedDict[bytes, deque[T]] = OrderedDict()  # by client in the order of their turns; no deque is empty
        self._count, self._closing = 0, False
        self._changed = threading.Condition()
        self._threads = [threading.Thread(target=self._run, name=f"{name}-{i}", daemon=True) for i in range(threads)]
        for thread in self._threads:
            thread.start()

    def offer(self, item: T, client: bytes = b"") -> T | None:
        """Add an item without waiting.

        Args:
            item: the item.
            client: id of its client.

        Returns:
            The rejected item if the queue is full: the newest of the busiest client, which may be this one. Otherwise None.
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

    def close(self, deadline: Deadline, extra: float = 0.0) -> list[T]:
        """Handle the waiting items until a deadline.

        Args:
            deadline: latest time to wait for the queue's threads.
            extra: time to wait after the deadline, s.

        Returns:
            The items that were not begun.
        """
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        for thread in self._threads:
            deadline.join(thread, extra)
        return self.take_all()

    def take_all(self) -> list[T]:
        """Remove and return all waiting items."""
        with self._changed:
            items = [item for waiting in self._waiting.values() for item in waiting]
            self._waiting.clear()
            self._count = 0
        return items

    def _next(self) -> T | None:
        """Wait for the next item and return it; None if the queue is closing and empty."""
        with self._changed:
            while not self._waiting and not self._closing:
                self._changed.wait()
            if not self._waiting:
                return None
            client, items = self._waiting.popitem(last=False)
            if len(items) > 1:
                self._waiting[client] = items  # its next turn is at the end of the round
            self._count -= 1
            return items.popleft()

    def _run(self) -> None:
        """Handle items until the queue is closed and empty."""
        while (item := self._next()) is not None:
            try:
                self._work(item)
            except Exception:
                log.exception("a request could not be answered")
            del item  # release the query before waiting: Zenoh ends a query when it is deleted
