"""The active plans of a server: begin, cancel, and answer exactly once. It does not use the network.

A plan is a move, a regrasp or the search for a grasp.

Each plan has an id, by which clients follow and cancel it, and a thread that waits for a planning process. Clients take turns.
A plan ends with the answer of its process, at the end of its budget, or when it is cancelled: then with the best plan so far.
"""

from __future__ import annotations

import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from graspforce.core import fields
from graspforce.core.errors import InvalidInput, RequestRefused
from graspforce.hand.hand import Hand
from graspforce.service.server.deadline import Deadline
from graspforce.service.server.limits import ServerLimits
from graspforce.service.server.plan_turns import ActivePlan, PlanTurns
from graspforce.service.server.server_load import client_label
from graspforce.service.wire import protocol
from graspforce.service.wire.reply import Reply, make_failure_reply
from graspforce.service.workers.jobs import ANSWER, PlanningJob, WorkerMessage, make_stopped_answer
from graspforce.service.workers.planning_worker import GRACE, PlanningWorker

_DEFAULT_BUDGET = 8.0  # s; Zenoh's queries wait for 10 s by default
_KILL_TIME = 0.2  # s, until a plan is answered after its process was killed
_MAX_MOVE_BYTES = 96 * 2**10  # a move and its hand must fit into the buffer of a pipe


class PlanRegistry:
    """The active plans by id. Thread-safe.

    Args:
        hands: the served hands by name.
        workers: planning processes; their number is the largest number of plans at work.
        limits: limits on plans.
        publish: called with the id of a plan and its progress.
        count: called with the key and the outcome of each answer.
    """

    def __init__(
        self,
        hands: Mapping[str, Hand],
        *,
        workers: Sequence[PlanningWorker],
        limits: ServerLimits,
        publish: Callable[[str, Reply], None],
        count: Callable[[str, str], None],
    ) -> None:
        self._hands, self._publish, self._count = hands, publish, count
        self._limits, self._workers, self._turns = limits, tuple(workers), PlanTurns(workers)
        self._lock = threading.Lock()
        self._active: dict[str, ActivePlan] = {}
        self._threads: set[threading.Thread] = set()
        self._closing = False
        self._stopped = threading.Event()

    def __len__(self) -> int:
        return len(self._active)

    def count_by_client(self) -> Counter[bytes]:
        """Return the number of active plans by session of the client."""
        with self._lock:
            return Counter(plan.client for plan in self._active.values())

    def begin(
        self,
        key: str,
        payload: bytes,
        encoding: str | None,
        answer: Callable[[Reply], None],
        received: float | None = None,
        client: bytes = b"",
    ) -> None:
        """Begin to plan a move or a regrasp, or to find a grasp, and return at once.

        Args:
            key: key of the request after the prefix: ``hands/<hand>/`` and one of `TASKS` of planning processes.
            payload: the encoded request.
            encoding: its Zenoh encoding; None for JSON.
            answer: called exactly once with the reply, from any thread. Invalid requests get an error record.
            received: when the request arrived, on the clock `time.perf_counter`, s; None for now.
            client: session of the client.
        """
        received = time.perf_counter() if received is None else received
        codec, sequence = protocol.JSON, None

        def done(message: WorkerMessage) -> None:
            self._count(key, message.outcome)  # without a latency: planning uses its whole budget
            answer(message.reply)

        try:
            codec = protocol.select_codec(encoding)
            if len(payload) > _MAX_MOVE_BYTES:
                raise RequestRefused(
                    "too_large", f"the request has {len(payload)} bytes: at most {_MAX_MOVE_BYTES} are allowed"
                )
            request = protocol.decode(payload, codec)
            sequence = protocol.find_sequence(request)
            self._start(ActivePlan(self._read_job(key, codec, request, received), client), done)
        except Exception as error:
            outcome, reply = make_failure_reply(codec, error, key, sequence, client_label(client))
            done(WorkerMessage(ANSWER, reply, outcome))

    def start_processes(self, delay: float) -> None:
        """Start the planning processes after a time, in the background; without hands, none.

        Args:
            delay: the time, s.
        """

        def start() -> None:
            if not self._stopped.wait(delay):
                self._turns.start_processes()

        if self._hands:
            threading.Thread(target=start, name="planners", daemon=True).start()

    def forget_hand(self, name: str) -> None:
        """Send a hand to the planning processes again with its next plan, because it has changed.

        Args:
            name: its name.
        """
        for worker in self._workers:
            worker.forget_hand(name)

    def cancel(self, id: str) -> bool:
        """Stop a plan; its answer is the best plan so far. Return False if there is no such plan.

        Args:
            id: id of the plan.
        """
        with self._lock:
            plan = self._active.get(id)
            if plan is not None:
                plan.cancel()
        return plan is not None

    def cancel_of(self, client: bytes) -> None:
        """Stop the plans of a client that has disconnected.

        Args:
            client: its session.
        """
        with self._lock:
            for plan in self._active.values():
                if plan.client == client:
                    plan.cancel()

    def stop(self) -> None:
        """Stop all plans and refuse new ones. The answers are the best plans so far."""
        with self._lock:
            self._closing = True
            self._stopped.set()
            for plan in self._active.values():
                plan.cancel()

    def close(self, deadline: Deadline) -> None:
        """Stop all plans, wait for their answers, and end the processes.

        Args:
            deadline: latest time to wait for processes.
        """
        self.stop()
        deadline.limit(2.0 * GRACE)
        last = Deadline(deadline.remaining + _KILL_TIME)
        for end in (deadline, last):
            for thread in list(self._threads):
                end.join(thread)
            for worker in self._workers:
                worker.close()  # this ends the wait of the remaining plans, and they are answered

    def _read_job(self, key: str, codec: str, request: object, received: float) -> PlanningJob:
        """Return the job of a request. The planning process reads the record itself."""
        envelope, record = protocol.Envelope.split(request)
        if envelope.backend is not None:
            raise InvalidInput("backend", envelope.backend, "absent: planning selects its own solvers")
        if not isinstance(record, Mapping):
            raise InvalidInput("", request, "a record (a JSON object)")
        move = dict(record)
        id = move.pop("id", None)
        id = uuid.uuid4().hex if id is None else protocol.check_named_id(id)
        max_budget = self._limits.plan_budget
        budget = min(_DEFAULT_BUDGET, max_budget) if envelope.budget is None else envelope.budget
        if budget > max_budget:
            raise InvalidInput("budget", budget, f"at most {max_budget:g} s")
        intervals = move.get("intervals")
        if intervals is not None:
            fields.check_integer(intervals, "intervals", minimum=2, maximum=self._limits.intervals)
        remaining = max(budget - (time.perf_counter() - received), 0.0)
        _, hand, task = key.split("/")
        return PlanningJob(id, hand, move, codec, envelope.sequence, budget, remaining, task=task)

    def _start(self, plan: ActivePlan, done: Callable[[WorkerMessage], None]) -> None:
        """Start the thread of a plan, or refuse it."""
        with self._lock:
            self._check_capacity(plan)
            self._active[plan.job.id] = plan
            thread = threading.Thread(target=self._run, args=(plan, done), name=f"plan-{plan.job.id}", daemon=True)
            self._threads.add(thread)
        thread.start()

    def _check_capacity(self, plan: ActivePlan) -> None:
        """Refuse a plan whose id is active, or that exceeds a limit."""
        if plan.job.id in self._active:
            raise InvalidInput("id", plan.job.id, "a new id: a plan with this id is active")
        if not self._workers:
            raise RequestRefused("overloaded", "this server does not plan moves")
        if self._closing:
            raise RequestRefused("closing", protocol.CLOSING_MESSAGE)
        own = [each for each in self._active.values() if each.client == plan.client]
        if len(self._active) >= len(self._workers) + self._limits.waiting_plans:
            message, others = f"{len(self._active)} plans are active: no more are allowed", list(self._active.values())
        elif len(own) >= self._limits.client_plans:
            message, others = f"{len(own)} plans of this client are active: no more are allowed", own
        else:
            return
        raise RequestRefused("overloaded", f"{message}; ask again when one has ended", min(each.remaining for each in others))

    def _run(self, plan: ActivePlan, done: Callable[[WorkerMessage], None]) -> None:
        """Run a job with the next free worker, and answer once."""
        job = plan.job

        def answer(message: WorkerMessage) -> None:
            with self._lock:  # before the answer, because its client may send the next request at once
                if self._active.get(job.id) is not plan:
                    return  # already answered
                del self._active[job.id]
            done(message)

        worker = self._turns.acquire(plan)
        message: WorkerMessage | None = None
        try:
            if worker is None:
                message = make_stopped_answer(job, plan.cancelled)
            else:
                current = replace(job, remaining=plan.remaining)
                message = worker.plan(
                    current, self._hands[job.hand_name], lambda progress: self._publish(job.id, progress), answer
                )
        except Exception as error:
            outcome, reply = make_failure_reply(job.codec, error, job.key, job.sequence, client_label(plan.client))
            message = WorkerMessage(ANSWER, reply, outcome)
        if worker is not None:
            self._turns.release(worker)
        if message is not None:
            answer(message)
        with self._lock:
            self._threads.remove(threading.current_thread())
