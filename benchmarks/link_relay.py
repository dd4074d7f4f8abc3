"""Links that can be slowed, cut and made lossy, without privileges: TCP bytes and UDP datagrams pass through this process.

A cut TCP link transfers nothing. When it heals, bytes that were sent in the meantime arrive, as TCP's retransmission does it.
Bytes that a lossy TCP link loses arrive after a retransmission, and so does everything after them. Datagrams that a UDP link
loses never arrive.
"""

from __future__ import annotations

import contextlib
import queue
import random
import socket
import threading
import time
from collections.abc import Callable

_CHUNK = 65536  # bytes
_POLL = 0.002  # s, while the link is cut
_Waiting = queue.SimpleQueue[tuple[float, bytes]]  # when each part is due, on the clock `time.monotonic`, s


class _Link:
    """State of a link, which may change at any time.

    Attributes:
        port: port of this machine at which it listens.
        delay: time that each direction adds, s.
        jitter: largest further time, s; uniformly random, and parts keep their order.
        loss: share of the parts that are lost, from 0 to 1.
        lost: number of lost parts.
        is_cut: whether nothing passes.
    """

    port: int

    def __init__(self) -> None:
        self.delay = self.jitter = self.loss = 0.0
        self.lost, self.is_cut = 0, False
        self._random = random.Random(1)

    def _is_lost(self) -> bool:
        """Return whether the next part is lost, and count it."""
        is_lost = self._random.random() < self.loss
        self.lost += is_lost
        return is_lost

    def _arrival(self) -> float:
        """Return when a part that was sent now arrives, on the clock `time.monotonic`, s."""
        return time.monotonic() + self.delay + self.jitter * self._random.random()

    def _wait(self, due: float) -> None:
        """Wait until a time, and until the link is not cut."""
        while self.is_cut or time.monotonic() < due:
            time.sleep(_POLL if self.is_cut else max(due - time.monotonic(), 0.0))


class LinkRelay(_Link):
    """A relay to a TCP port of this machine. Use it as a context manager.

    Args:
        target: port to which it connects.
        retransmission: time until lost bytes are sent again, s; doubled each time they are lost again.
    """

    def __init__(self, target: int, retransmission: float = 0.02) -> None:
        super().__init__()
        self._target, self._retransmission = target, retransmission
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._sockets: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> LinkRelay:
        return self

    def __exit__(self, *exception: object) -> None:
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        for each in (self._listener, *self._sockets):
            each.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near = self._listener.accept()[0]
                far = socket.create_connection(("127.0.0.1", self._target))
                self._sockets += [near, far]
                for source, sink in ((near, far), (far, near)):
                    source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    waiting: _Waiting = queue.SimpleQueue()
                    threading.Thread(target=self._read, args=(source, waiting), daemon=True).start()
                    threading.Thread(target=self._write, args=(sink, waiting), daemon=True).start()

    def _read(self, source: socket.socket, waiting: _Waiting) -> None:
        data = b"x"
        while data:
            try:
                data = source.recv(_CHUNK)
            except OSError:
                data = b""
            due, pause = self._arrival(), self._retransmission
            while data and self._is_lost():
                due, pause = due + pause, 2.0 * pause
            waiting.put((due, data))

    def _write(self, sink: socket.socket, waiting: _Waiting) -> None:
        with contextlib.suppress(OSError):
            while True:
                due, data = waiting.get()
                self._wait(due)
                if not data:
                    sink.shutdown(socket.SHUT_RDWR)
                    return
                sink.sendall(data)


class DatagramRelay(_Link):
    """A relay to a UDP port of this machine, for one client at a time. Use it as a context manager.

    Args:
        target: port to which it sends.
    """

    def __init__(self, target: int) -> None:
        super().__init__()
        self._near, self._far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._near.bind(("127.0.0.1", 0))
        self._far.connect(("127.0.0.1", target))
        self.port = int(self._near.getsockname()[1])
        self._client: tuple[str, int] | None = None
        self._is_open = True
        for read, send in ((self._read_near, self._far.send), (self._read_far, self._send_near)):
            waiting: _Waiting = queue.SimpleQueue()
            threading.Thread(target=self._read, args=(read, waiting), daemon=True).start()
            threading.Thread(target=self._write, args=(send, waiting), daemon=True).start()

    def __enter__(self) -> DatagramRelay:
        return self

    def __exit__(self, *exception: object) -> None:
        self._is_open = False
        for each in (self._near, self._far):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def _read_near(self) -> bytes:
        data, self._client = self._near.recvfrom(_CHUNK)
        return data

    def _read_far(self) -> bytes:
        return self._far.recv(_CHUNK)

    def _send_near(self, data: bytes) -> None:
        if self._client is not None:
            self._near.sendto(data, self._client)

    def _read(self, read: Callable[[], bytes], waiting: _Waiting) -> None:
        while self._is_open:
            try:
                data = read()
            except OSError:  # nobody listens at the other end yet, or the relay is closed
                time.sleep(_POLL)
                continue
            if not self._is_lost() and not self.is_cut:
                waiting.put((self._arrival(), data))

    def _write(self, send: Callable[[bytes], object], waiting: _Waiting) -> None:
        while self._is_open:
            with contextlib.suppress(queue.Empty):
                due, data = waiting.get(timeout=1.0)
                self._wait(due)
                with contextlib.suppress(OSError):
                    send(data)
