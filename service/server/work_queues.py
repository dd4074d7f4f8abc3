"""The queues of a server. Requests of different cost wait apart and have workers of their own.

| class    | requests                                                                        | threads          |
|----------|---------------------------------------------------------------------------------|------------------|
| status   | ``status``, descriptions, ``forward``, unknown keys                             | 1                |
| small    | ``control``, ``inverse``, opening and closing streams; ``solve``, ``distribute`` | `solver_threads` |
| large    | ``quality``, ``explain``; ``solve`` and ``distribute`` of more than 8 KiB       | `large_threads`  |
| plans    | moves and grasps; planning processes do the work                                | 1                |
| refusals | requests that the other queues rejected                                         | 1                |

A request of one class therefore never waits for one of another. The size of a request is that of its payload: in
MessagePack, 75 contacts have 8 KiB. It is known before the request is read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import zenoh

from graspforce.hand.hand import Hand
from graspforce.service.server.client_sessions import ClientName
from graspforce.service.server.fair_queue import FairQueue
from graspforce.service.server.free_memory import release_free_memory
from graspforce.service.server.limits import ServerLimits
from graspforce.service.server.request_worker import RequestWorker, RequestWorkers
from graspforce.service.workers.jobs import TASKS

_LARGE_BYTES = 8 * 2**10  # of the payload of a large problem
_STATUS_CAPACITY = 256  # waiting requests
_REFUSAL_CAPACITY = 4096  # waiting refusals; further queries end without a reply
_RELEASE_BYTES = 16 * 2**20  # that pass the queues until free memory is released
QUERY_BYTES = 1024  # of a waiting query beside its payload


class CostClass(Enum):
    """Cost of a request."""

    STATUS = "status"
    SMALL = "small"
    LARGE = "large"
    PLAN = "plans"


_NICENESS = {CostClass.SMALL: 10, CostClass.LARGE: 15}  # of worker processes: streams have priority if processors are short


@dataclass(frozen=True, eq=False, slots=True)
class QueuedQuery:
    """A query.

    Args:
        key: its key after the prefix.
        query: the query.
        received: when it arrived, on the clock `time.perf_counter`, s.
        client: its client.
        cost: its class.
        size: its bytes in a queue.
    """

    key: str
    query: zenoh.Query
    received: float
    client: ClientName
    cost: CostClass
    size: int


@dataclass(frozen=True, slots=True)
class CancelRequest:
    """A request to cancel a plan. It waits in the queue of plans, and is repeated while it may be ahead of the plan's query."""

    id: str
    tries: int = 0


@dataclass(frozen=True, slots=True)
class QueueOptions:
    """Sizes of the queues.

    Args:
        solver_threads: threads for small requests.
        large_threads: threads for large requests.
        capacity: small requests, and large requests, that may wait.
        max_bytes: bytes that may wait in each queue.
    """

    solver_threads: int
    large_threads: int
    capacity: int
    max_bytes: int

    def start_workers(self, hands: Sequence[Hand], limits: ServerLimits) -> dict[CostClass, RequestWorkers]:
        """Start a worker process for each thread of small and large requests, and return them.

        Args:
            hands: the served hands.
            limits: limits on requests.
        """
        counts = {CostClass.SMALL: self.solver_threads, CostClass.LARGE: self.large_threads}
        return {
            cost: RequestWorkers([RequestWorker(hands, limits, _NICENESS[cost]) for _ in range(count)])
            for cost, count in counts.items()
        }


class WorkQueues:
    """The queues of a server and their threads.

    Attributes:
        plans: requests for plans, and their cancellations.
        refusals: rejected requests.

    Args:
        options: sizes.
        answer: function that answers a request of the classes status, small and large.
        plan: function that begins or cancels a plan.
        refuse: function that refuses a request.
    """

    def __init__(
        self,
        options: QueueOptions,
        answer: Callable[[QueuedQuery], None],
        plan: Callable[[QueuedQuery | CancelRequest], None],
        refuse: Callable[[QueuedQuery], None],
    ) -> None:
        sizes = {"capacity": options.capacity, "max_bytes": options.max_bytes}
        other = {"capacity": _STATUS_CAPACITY, "max_bytes": options.max_bytes}
        self._offered_bytes = 0  # since memory was released
        self.plans: FairQueue[QueuedQuery | CancelRequest] = FairQueue("plans", plan, **other)
        self._by_class: dict[CostClass, FairQueue[Any]] = {
            CostClass.SMALL: FairQueue("small", answer, threads=options.solver_threads, **sizes),
            CostClass.LARGE: FairQueue("large", answer, threads=options.large_threads, **sizes),
            CostClass.STATUS: FairQueue("status", answer, **other),
            CostClass.PLAN: self.plans,
        }
        self.refusals: FairQueue[QueuedQuery] = FairQueue(
            "refusals", refuse, capacity=_REFUSAL_CAPACITY, max_bytes=options.max_bytes
        )

    def __getitem__(self, cost: CostClass) -> FairQueue[Any]:
        return self._by_class[cost]

    def __iter__(self) -> Iterator[FairQueue[Any]]:
        """Iterate over the queues without that of refusals."""
        return iter(self._by_class.values())

    @property
    def waiting(self) -> int:
        """Number of waiting small and large requests."""
        return len(self._by_class[CostClass.SMALL]) + len(self._by_class[CostClass.LARGE])

    @property
    def waiting_bytes(self) -> int:
        """Bytes of all waiting requests."""
        return sum(each.bytes for each in self)

    @property
    def longest_work(self) -> float:
        """Time since the oldest of the present works began, s."""
        return max(each.longest_work for each in self)

    def count_by_client(self) -> Counter[bytes]:
        """Return the number of waiting requests by session of the client."""
        return sum((each.count_by_client() for each in self), Counter[bytes]())

    def offer(self, item: QueuedQuery) -> None:
        """Put a query into the queue of its class, and the rejected ones into that of refusals.

        Args:
            item: the query.
        """
        self._offered_bytes += item.size
        for rejected in self._by_class[item.cost].offer(item, item.client.session, item.client.name, item.size):
            if isinstance(rejected, QueuedQuery):
                self.refuse(rejected)

    def refuse(self, item: QueuedQuery) -> None:
        """Put a query into the queue of refusals. If that is full, queries end without a reply.

        Args:
            item: the query.
        """
        self.refusals.offer(item, item.client.session, item.client.name, item.size)

    def release_memory(self) -> None:
        """Return free memory to the operating system if many bytes have passed the queues, and none wait now."""
        if self._offered_bytes > _RELEASE_BYTES and self.waiting_bytes == 0:
            self._offered_bytes = 0
            release_free_memory()

    def expected_wait(self, item: QueuedQuery) -> float:
        """Return the time until a query of the same class that arrives now is answered, s.

        Args:
            item: the query.
        """
        return self._by_class[item.cost].expected_wait

    def drop(self, session: bytes) -> None:
        """Drop the waiting requests of a client that has disconnected. Zenoh ends a query when it is deleted.

        Args:
            session: its session.
        """
        for each in (*self, self.refusals):
            each.drop(session)


def cost_class(key: str, size: int) -> CostClass:
    """Return the class of a request of a served key.

    Args:
        key: key after the prefix.
        size: bytes of its payload.
    """
    first, *rest = key.split("/")
    task = rest[-1] if first == "hands" and len(rest) == 2 else ""
    if first in ("quality", "explain"):
        return CostClass.LARGE
    if first == "solve" or task == "distribute":
        return CostClass.LARGE if size > _LARGE_BYTES else CostClass.SMALL
    if first == "streams" or task in ("control", "inverse"):
        return CostClass.SMALL
    return CostClass.PLAN if task in TASKS else CostClass.STATUS
