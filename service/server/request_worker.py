"""The server's handles of its worker processes, which answer requests without delaying control streams."""

from __future__ import annotations

import dataclasses
import logging
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection

from graspforce.hand.hand import Hand
from graspforce.service.server.limits import ServerLimits
from graspforce.service.server.log_format import present_logging
from graspforce.service.server.request_process import START, ProcessAnswer, ProcessRequest, ProcessSetup
from graspforce.service.wire import protocol
from graspforce.service.wire.reply import Reply, make_error_reply
from graspforce.service.workers.worker_process import start_piped_worker

log = logging.getLogger("graspforce.service")

COMMAND = (sys.executable, "-c", START)
_DIED = "the process of this request ended unexpectedly; the server's log has the details"


class RequestWorker:
    """One worker process. One thread at a time gives it requests.

    A process that ends, or that works on a request for longer than the limit `stall_time`, is replaced.

    Args:
        hands: the served hands.
        limits: limits on requests.
        niceness: how far its priority is below that of the server; as in `start_worker`.
        command: command line of the process; the number of its pipe is appended.
    """

    def __init__(self, hands: Sequence[Hand], limits: ServerLimits, niceness: int, command: tuple[str, ...] = COMMAND) -> None:
        self._setup = ProcessSetup(hands, limits, present_logging())
        self._command, self._niceness = command, niceness
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Connection | None = None
        self._sent_setup: ProcessSetup | None = None
        self._is_closed = False

    def start(self) -> None:
        """Start the process, and do not wait until it can answer."""
        process, ours = start_piped_worker(self._command, self._niceness)
        with self._lock:
            self._process, self._pipe, self._sent_setup = process, ours, None
        if self._is_closed:
            self._kill()

    def serve(self, hands: Sequence[Hand]) -> None:
        """Serve other hands, from the next request on.

        Args:
            hands: the hands.
        """
        self._setup = dataclasses.replace(self._setup, hands=hands)

    def compute(
        self, key: str, payload: bytes, encoding: str | None, received: float, client: bytes = b""
    ) -> tuple[str, Reply]:
        """Return the outcome and the reply of a request; see `RequestHandler.compute`.

        Args:
            key: key after the prefix.
            payload: the encoded request.
            encoding: its Zenoh encoding; None for JSON.
            received: when it arrived, on the clock `time.perf_counter`, s.
            client: session of its client.
        """
        limit = self._setup.limits.stall_time
        try:
            if self._pipe is None and not self._is_closed:
                self.start()
            pipe = self._pipe
            if pipe is None:
                return _refuse(encoding, "closing", protocol.CLOSING_MESSAGE)
            setup = self._setup
            if self._sent_setup is not setup:
                pipe.send(setup)
                self._sent_setup = setup
            pipe.send(ProcessRequest(key, payload, encoding, time.perf_counter() - received, client))
            if pipe.poll(limit):
                answer: ProcessAnswer = pipe.recv()
                return answer.outcome, answer.reply
            log.error("worker process killed: it did not answer a request to %s within %g s", key, limit)
            self._kill()
            return _refuse(encoding, "deadline", f"the work was not finished within {limit:g} s")
        except (EOFError, OSError):
            self._kill()
            if self._is_closed:
                return _refuse(encoding, "closing", protocol.CLOSING_MESSAGE)
            log.exception("worker process ended during a request to %s", key)
            return _refuse(encoding, "internal", _DIED)

    def close(self) -> None:
        """Kill the process, and end its request. No further process is started."""
        self._is_closed = True
        self._kill()

    def _kill(self) -> None:
        """Kill the process. The next request starts another."""
        with self._lock:
            process, self._process, self._pipe = self._process, None, None
        if process is not None:
            process.kill()  # a thread that waits for its answer then reads the end of the pipe, and drops it
            process.wait()


class RequestWorkers:
    """Worker processes of the threads of a queue: each thread finds a free one.

    Args:
        workers: the processes.
    """

    def __init__(self, workers: Sequence[RequestWorker]) -> None:
        self._workers = tuple(workers)
        self._free: queue.SimpleQueue[RequestWorker] = queue.SimpleQueue()
        for worker in workers:
            worker.start()
            self._free.put(worker)

    def serve(self, hands: Sequence[Hand]) -> None:
        """Serve other hands, from the next requests on.

        Args:
            hands: the hands.
        """
        for worker in self._workers:
            worker.serve(hands)

    def compute(
        self, key: str, payload: bytes, encoding: str | None, received: float, client: bytes = b""
    ) -> tuple[str, Reply]:
        """Return the outcome and the reply of a request by a free process.

        Args:
            key: as in `RequestWorker.compute`.
            payload: as in `RequestWorker.compute`.
            encoding: as in `RequestWorker.compute`.
            received: as in `RequestWorker.compute`, s.
            client: as in `RequestWorker.compute`.
        """
        worker = self._free.get()
        try:
            return worker.compute(key, payload, encoding, received, client)
        finally:
            self._free.put(worker)

    def close(self) -> None:
        """Kill the processes, and end their requests."""
        for worker in self._workers:
            worker.close()


def _refuse(encoding: str | None, code: str, message: str) -> tuple[str, Reply]:
    """Return the outcome and the reply of a request without an answer."""
    codec = protocol.MSGPACK if encoding and protocol.MSGPACK in encoding else protocol.JSON
    return code, make_error_reply(codec, code, message, None, None)
