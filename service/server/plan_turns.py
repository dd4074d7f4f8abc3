"""Planning processes for the plans of several clients, which take turns."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Sequence

from graspforce.service.workers.jobs import PlanningJob
from graspforce.service.workers.planning_worker import PlanningWorker

_POLL_PERIOD = 0.05  # s, between checks whether a waiting plan was cancelled
_MAX_CLIENTS = 256  # whose last turns are remembered


class ActivePlan:
    """A plan without an answer yet.

    Attributes:
        job: the move.
        client: session of its client.
        worker: the worker that plans it; None while it waits for one.
        cancelled: True after a cancel.
    """

    def __init__(self, job: PlanningJob, client: bytes = b"") -> None:
        self.job, self.client, self.cancelled = job, client, False
        self.worker: PlanningWorker | None = None
        self._deadline = time.monotonic() + job.remaining

    @property
    def remaining(self) -> float:
        """Part of the budget that remains, s."""
        return max(self._deadline - time.monotonic(), 0.0)

    def cancel(self) -> None:
        """Stop the plan now, or when it begins."""
        self.cancelled = True
        if self.worker is not None:
            self.worker.cancel()


class PlanTurns:
    """The free workers, and the plans that wait for them. The next plan is of the client whose last turn is longest ago.

    Args:
        workers: the workers.
    """

    def __init__(self, workers: Sequence[PlanningWorker]) -> None:
        self._free, self._waiting = list(workers), list[ActivePlan]()
        self._last_turns: OrderedDict[bytes, int] = OrderedDict()  # number of the last turn by client
        self._turn = 0
        self._changed = threading.Condition()

    def acquire(self, plan: ActivePlan) -> PlanningWorker | None:
        """Wait for a worker and reserve it; None if the plan is cancelled or its budget ends first.

        A worker that exceeded the budget of its last plan may need time to become free.

        Args:
            plan: the plan; its `worker` is set.
        """
        with self._changed:
            self._waiting.append(plan)
            try:
                while not (self._free and self._next() is plan):
                    if plan.cancelled or plan.remaining <= 0.0:
                        return None
                    self._changed.wait(min(_POLL_PERIOD, plan.remaining))
                self._count_turn(plan.client)
                plan.worker = worker = self._free.pop(0)
                worker.reserve(plan.remaining)
                if plan.cancelled:
                    worker.cancel()
                return worker
            finally:
                self._waiting.remove(plan)
                self._changed.notify_all()

    def start_processes(self) -> None:
        """Start the processes of the free workers, so that the first plans do not wait for them."""
        with self._changed:
            workers, self._free = self._free, []
        for worker in workers:
            worker.start()
            self.release(worker)

    def release(self, worker: PlanningWorker) -> None:
        """Return a worker.

        Args:
            worker: the worker.
        """
        with self._changed:
            self._free.append(worker)
            self._changed.notify_all()

    def _next(self) -> ActivePlan:
        """Return the waiting plan whose turn it is: the oldest one of the client whose last turn is longest ago."""
        return min(self._waiting, key=lambda plan: self._last_turns.get(plan.client, 0))

    def _count_turn(self, client: bytes) -> None:
        """Remember the turn of a client."""
        self._turn += 1
        self._last_turns[client] = self._turn
        self._last_turns.move_to_end(client)
        if len(self._last_turns) > _MAX_CLIENTS:
            self._last_turns.popitem(last=False)
