"""Fair queues: requests wait here between the network's thread and the threads that answer them.

Clients take turns: the queue serves one item of each waiting client per round. Within a client the names that it uses take
turns too, first in, first out within each name. If the queue is full, the newest items of the busiest client are rejected. A
client with many requests or names therefore delays a request of another client by at most one item per round.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeAlias, TypeVar

from graspforce.service.server.deadline import Deadline

T = TypeVar("T")
ClientId: TypeAlias = bytes

log = logging.getLogger("graspforce.service")

_MEMORY = 0.9  # weight of earlier items in the mean time of an item


class _Entry(NamedTuple, Generic[T]):
    """An item and its size, bytes."""

    item: T
    size: int


class _ClientItems(Generic[T]):
    """The waiting items of a client, by name in the order of their turns."""

    def __init__(self) -> None:
        self.by_name: OrderedDict[bytes, deque[_Entry[T]]] = OrderedDict()  # no deque is empty
        self.count = self.bytes = 0

    def add(self, name: bytes, entry: _Entry[T]) -> None:
        """Add the newest item of a name."""
        self.by_name.setdefault(name, deque()).append(entry)
        self.count += 1
        self.bytes += entry.size

    def take_next(self) -> _Entry[T]:
        """Remove and return the oldest item of the next name."""
        name, entries = self.by_name.popitem(last=False)
        entry = entries.popleft()
        if entries:
            self.by_name[name] = entries  # its next turn is at the end of the round
        return self._taken(entry)

    def take_newest(self) -> _Entry[T]:
        """Remove and return the newest item of the busiest name."""
        name, entries = max(self.by_name.items(), key=lambda each: len(each[1]))
        entry = entries.pop()
        if not entries:
            del self.by_name[name]
        return self._taken(entry)

    def _taken(self, entry: _Entry[T]) -> _Entry[T]:
        """Count a removed item."""
        self.count -= 1
        self.bytes -= entry.size
        return entry


class FairQueue(Generic[T]):
    """A bounded queue with its own threads, round-robin between clients.

    Args:
        name: prefix of the threads' names.
        work: function that handles an item.
        threads: number of threads.
        capacity: largest number of waiting items; None for no limit.
        max_bytes: largest sum of their sizes, bytes; None for no limit.
    """

    def __init__(
        self,
        name: str,
        work: Callable[[T], None],
        *,
        threads: int = 1,
        capacity: int | None = None,
        max_bytes: int | None = None,
    ) -> None:
        self._work, self._capacity, self._max_bytes = work, capacity, max_bytes
        self._waiting: OrderedDict[bytes, _ClientItems[T]] = OrderedDict()  # by client, in the order of their turns
        self._count, self._bytes, self._closing = 0, 0, False
        self._mean_seconds = 0.0  # of the work on an item
        self._begun: dict[int, float] = {}  # by thread, when it began its present work
        self._changed = threading.Condition()
        self._threads = [threading.Thread(target=self._run, name=f"{name}-{i}", daemon=True) for i in range(threads)]
        for thread in self._threads:
            thread.start()

    def offer(self, item: T, client: bytes = b"", name: bytes = b"", size: int = 0) -> list[T]:
        """Add an item without waiting.

        Args:
            item: the item.
            client: id of its client.
            name: name that the client gives itself.
            size: size of the item, bytes.

        Returns:
            The rejected items, if the queue is full: the newest of the busiest client, or this one.
        """
        with self._changed:
            rejected: list[T] = []
            while (excess := self._find_excess(size)) is not None:
                busiest = max(self._waiting.values(), key=excess, default=None)
                own = self._waiting.get(client) or _ClientItems[T]()
                if busiest is None or excess(busiest) <= excess(own) + (size if excess is _bytes_of else 1):
                    return [*rejected, item]
                rejected.append(self._count_taken(busiest.take_newest()))
                self._waiting = OrderedDict((id, items) for id, items in self._waiting.items() if items.count)
            self._waiting.setdefault(client, _ClientItems()).add(name, _Entry(item, size))
            self._count += 1
            self._bytes += size
            self._changed.notify()
            return rejected

    def drop(self, client: bytes) -> list[T]:
        """Remove and return the waiting items of a client.

        Args:
            client: id of the client.
        """
        with self._changed:
            items = self._waiting.pop(client, None)
            dropped = [] if items is None else [entry for entries in items.by_name.values() for entry in entries]
            return [self._count_taken(entry) for entry in dropped]

    def __len__(self) -> int:
        return self._count

    @property
    def bytes(self) -> int:
        """Sum of the sizes of the waiting items."""
        return self._bytes

    def count_by_client(self) -> Counter[ClientId]:
        """Return the number of waiting items by client."""
        with self._changed:
            return Counter({client: items.count for client, items in self._waiting.items()})

    @property
    def longest_work(self) -> float:
        """Time since the oldest of the present works began, s; 0 if the threads are idle."""
        begun = list(self._begun.values())
        return time.perf_counter() - min(begun) if begun else 0.0

    @property
    def expected_wait(self) -> float:
        """Time until an item that is added now is handled, s, from the mean time of the last items."""
        return self._count * self._mean_seconds / max(len(self._threads), 1)

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
            entries = [entry for items in self._waiting.values() for waiting in items.by_name.values() for entry in waiting]
            self._waiting.clear()
            return [self._count_taken(entry) for entry in entries]

    def _find_excess(self, size: int) -> Callable[[_ClientItems[T]], int] | None:
        """Return the measure by which the queue is full for an item of a size; None if it is not."""
        if self._capacity is not None and self._count >= self._capacity:
            return _count_of
        return _bytes_of if self._max_bytes is not None and self._bytes + size > self._max_bytes else None

    def _count_taken(self, entry: _Entry[T]) -> T:
        """Count a removed item and return it."""
        self._count -= 1
        self._bytes -= entry.size
        return entry.item

    def _next(self) -> T | None:
        """Wait for the next item and return it; None if the queue is closing and empty."""
        with self._changed:
            while not self._waiting and not self._closing:
                self._changed.wait()
            if not self._waiting:
                return None
            client, items = self._waiting.popitem(last=False)
            entry = items.take_next()
            if items.count:
                self._waiting[client] = items  # its next turn is at the end of the round
            return self._count_taken(entry)

    def _run(self) -> None:
        """Handle items until the queue is closed and empty."""
        while (item := self._next()) is not None:
            start = self._begun[threading.get_ident()] = time.perf_counter()
            try:
                self._work(item)
            except Exception:
                log.exception("a request could not be answered")
            del self._begun[threading.get_ident()]
            del item  # release the query before waiting: Zenoh ends a query when it is deleted
            self._mean_seconds += (1.0 - _MEMORY) * (time.perf_counter() - start - self._mean_seconds)


def _count_of(items: _ClientItems[T]) -> int:
    """Return the number of waiting items of a client."""
    return items.count


def _bytes_of(items: _ClientItems[T]) -> int:
    """Return the bytes of the waiting items of a client."""
    return items.bytes
