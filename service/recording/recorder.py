"""The recorder of a server: it passes exchanges to a process that writes them to a file.

The threads of the server only append to a queue. One thread sends the queue to the process, every 20 ms. If the process or the
disk is too slow, the queue is full and exchanges are dropped: the server never waits. Dropped exchanges are counted by stream,
and the recording has their number where they are missing.
"""

from __future__ import annotations

import dataclasses
import logging
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import msgspec

from graspforce.core.optional_libraries import require_libraries
from graspforce.hand.hand import Hand
from graspforce.service.recording.exchange import (
    LENGTH_BYTES,
    Batch,
    End,
    Exchange,
    Header,
    Message,
    recorded_hand,
    this_machine,
    this_version,
)
from graspforce.service.workers.worker_process import start_worker

log = logging.getLogger("graspforce.service")

COMMAND = (sys.executable, "-c", "from graspforce.service.recording.recording_process import main; main()")
_NICENESS = 10  # of the process: streams have priority if processors are short
_PERIOD = 0.02  # s, between two batches
_BATCH_BYTES = 2**18  # of one message to the process: encoding it delays other threads for about 50 µs
_QUEUE_BYTES = 64 * 2**20  # that may wait: about 20 s of a stream at 1 kHz


@dataclasses.dataclass(frozen=True, slots=True)
class RecorderOptions:
    """How exchanges are passed on.

    Args:
        queue_bytes: bytes that may wait; beyond, exchanges are dropped.
        command: command line of the process; the path of the file is appended.
    """

    queue_bytes: int = _QUEUE_BYTES
    command: tuple[str, ...] = COMMAND


class Recorder:
    """The recorder of one server.

    Args:
        path: the file; an existing file is replaced.
        options: how exchanges are passed on.

    Attributes:
        path: the file.
        written: number of exchanges that were sent to the process.
        dropped: number of dropped exchanges by stream, and of requests.

    Raises:
        MissingLibrary: a library of the extra `record` is not installed.
    """

    def __init__(self, path: Path, options: RecorderOptions | None = None) -> None:
        require_libraries("mcap", "foxglove")
        self.path, self._options = path, options or RecorderOptions()
        self.written, self.dropped = 0, Counter[str]()
        self._gaps: Counter[str] = Counter()  # dropped since the last exchange of the same stream
        self._lock = threading.Lock()
        self._queue: list[Exchange] = []
        self._bytes = 0
        self._ended = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread: threading.Thread | None = None

    def start(self, hands: Sequence[Hand], limits: dict[str, int | float]) -> None:
        """Start the process and the thread.

        Args:
            hands: the served hands.
            limits: the limits of the server by name.

        Raises:
            OSError: the file cannot be written.
        """
        self.path.open("wb").close()
        command = [*self._options.command, str(self.path)]
        self._process = start_worker(command, _NICENESS, stdin=subprocess.PIPE)
        clock = time.time_ns() - time.perf_counter_ns()
        header = Header(clock, this_version(), this_machine(), tuple(map(recorded_hand, hands)), limits)
        self._thread = threading.Thread(target=self._run, args=(header,), name="recorder", daemon=True)
        self._thread.start()

    def offer(self, exchange: Exchange) -> None:
        """Record an exchange, or drop it if the queue is full. Any thread may call it; it does not wait.

        Args:
            exchange: the exchange.
        """
        size = len(exchange.payload) + len(exchange.reply)
        source = exchange.source
        with self._lock:
            if self._ended.is_set() or self._bytes + size > self._options.queue_bytes:
                self._gaps[source] += 1
                self.dropped[source] += 1
                return
            if source in self._gaps:
                exchange.dropped = self._gaps.pop(source)
            self._bytes += size
            self._queue.append(exchange)

    def close(self, timeout: float) -> None:
        """Record no more, and wait until the file is complete. The process finishes the file later if it needs longer.

        Args:
            timeout: longest wait, s.
        """
        if self._thread is None or self._process is None:
            return
        self._ended.set()
        process = self._process
        waiting = threading.Thread(target=process.wait, name="recording", daemon=True)  # also if this returns earlier
        waiting.start()
        waiting.join(timeout)
        if waiting.is_alive():
            log.warning("%s is not complete yet: another process writes the rest", self.path)
        self._thread = None

    def wait(self) -> None:
        """Wait after `close` until the file is complete."""
        if self._process is not None:
            self._process.wait()

    def _run(self, header: Header) -> None:
        """Send the queue to the process until the end."""
        assert self._process is not None
        assert self._process.stdin is not None
        try:
            with self._process.stdin as pipe:
                _send(pipe, header)
                while True:
                    is_last = self._ended.wait(_PERIOD)
                    self._send_queue(pipe)
                    if is_last:
                        _send(pipe, End(self.written, dict(self.dropped)))
                        return
        except OSError:  # the process has ended, for example because the disk is full
            log.error("%s: the recording has ended early, after %d exchanges", self.path, self.written)
            self._ended.set()

    def _send_queue(self, pipe: IO[bytes]) -> None:
        """Send all exchanges of the queue."""
        with self._lock:
            waiting, self._queue = self._queue, []
        while waiting:
            count, size = 0, 0
            while count < len(waiting) and size < _BATCH_BYTES:
                size += len(waiting[count].payload) + len(waiting[count].reply)
                count += 1
            _send(pipe, Batch(waiting[:count]))
            self.written += count
            with self._lock:
                self._bytes -= size
            waiting = waiting[count:]


def _send(pipe: IO[bytes], message: Message) -> None:
    """Send a message with its length before it.

    Raises:
        OSError: the process has ended.
    """
    payload = msgspec.msgpack.encode(message)
    pipe.write(len(payload).to_bytes(LENGTH_BYTES, "little"))
    pipe.write(payload)
    pipe.flush()
