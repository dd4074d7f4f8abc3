"""The program of a worker process: it receives requests and answers them with encoded records.

Python runs one thread of a process at a time. In the server's own process, requests would delay its control streams.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection

from graspforce.hand.hand import Hand
from graspforce.service.server.free_memory import release_free_memory
from graspforce.service.server.limits import ServerLimits
from graspforce.service.server.log_format import configure_logging
from graspforce.service.server.request_handler import RequestHandler
from graspforce.service.wire.reply import Reply

START = "from graspforce.service.server.request_process import main; main()"
_RELEASE_BYTES = 2**20  # of a request after which free memory is released
_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")


@dataclass(frozen=True, eq=False, slots=True)
class ProcessSetup:
    """First message to a worker process.

    Args:
        hands: the served hands.
        limits: limits on requests.
        log: level and format of the log; None for Python's default.
    """

    hands: Sequence[Hand]
    limits: ServerLimits
    log: tuple[str, str] | None = None


@dataclass(frozen=True, eq=False, slots=True)
class ProcessRequest:
    """A request to a worker process.

    Args:
        key: its key after the prefix.
        payload: the encoded request.
        encoding: its Zenoh encoding; None for JSON.
        elapsed: time since its arrival, s.
        client: session of its client.
    """

    key: str
    payload: bytes
    encoding: str | None
    elapsed: float
    client: bytes = b""


@dataclass(frozen=True, eq=False, slots=True)
class ProcessAnswer:
    """The answer of a worker process.

    Args:
        outcome: "ok" or an error code.
        reply: the reply.
    """

    outcome: str
    reply: Reply


def main() -> None:
    """Answer the requests that arrive through a pipe until it is closed.

    The last command-line argument is the number of the pipe.
    """
    for name in _SIGNALS:  # a service manager signals all processes; the server ends this one after its last answer
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    pipe = Connection(int(sys.argv[-1]))
    try:
        setup: ProcessSetup = pipe.recv()
        if setup.log is not None:
            configure_logging(*setup.log)
        handler = RequestHandler(setup.hands, limits=setup.limits)
        while True:
            request: ProcessRequest | ProcessSetup = pipe.recv()
            if isinstance(request, ProcessSetup):  # a hand has changed
                handler = RequestHandler(request.hands, limits=request.limits)
                continue
            received = time.perf_counter() - request.elapsed
            asked = request.key, request.payload, request.encoding, received, request.client
            pipe.send(ProcessAnswer(*handler.compute(*asked)))
            if len(request.payload) > _RELEASE_BYTES:
                del request
                release_free_memory()
    except (EOFError, OSError):
        return  # the server has ended
