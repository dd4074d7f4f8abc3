"""Serving until a signal: the main thread of ``graspforce serve``, and the end of its process."""

from __future__ import annotations

import gc
import logging
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from types import FrameType
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from graspforce.core.optional_libraries import optional_imports
from graspforce.hand.hand import Hand
from graspforce.service.server.deadline import Deadline
from graspforce.service.server.free_memory import share_heap
from graspforce.service.server.hand_files import HandFiles
from graspforce.service.server.server import Server
from graspforce.service.server.service_manager import ServiceManager

if TYPE_CHECKING:
    from graspforce.service.server.monitoring import MonitoringServer

log = logging.getLogger("graspforce.service")

_GRACE = 1.2  # s, to answer the waiting requests at the end; the process ends within 2 s
_END_DELAY = 0.6  # s after the grace, until a process that should end is ended
_SIGNAL_CHECK_PERIOD = 0.02  # s
_WATCH_PERIOD = 0.5  # s, between checks of the hands' files
_COLLECT_PERIOD = 60.0  # s, between two full collections of unused objects
_SWITCH_INTERVAL = 1e-4  # s; with Python's default of 5 ms, a reply could wait so long for another thread
_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """How a process serves.

    Args:
        on_ready: called with the server when it serves.
        metrics: ``HOST:PORT`` of metrics, health and readiness over HTTP, or a port of this machine; None for none.
        attach: called with the server when it serves; returns a context that is open while it does, such as a node of ROS 2.
        watch: hands whose description files are read again when they change, as in `Server`.
        grace: time to wait for answers at the end, s.
        end_process: end the process with exit code 0 instead of returning: at most 0.6 s after the grace even if a solver or
            the network does not return, and at once at a second signal.
    """

    on_ready: Callable[[Server], None] | None = None
    metrics: str | None = None
    attach: Callable[[Server], AbstractContextManager[object]] | None = None
    watch: Sequence[str | os.PathLike[str] | Hand] = ()
    grace: float = _GRACE
    end_process: bool = False


def serve(
    hands: Sequence[str | os.PathLike[str] | Hand] = (),
    *,
    listen: str | None = None,
    config: str | os.PathLike[str] | None = None,
    on_ready: Callable[[Server], None] | None = None,
    insecure: bool = False,
    secure: str | os.PathLike[str] | None = None,
    grace: float = _GRACE,
    end_process: bool = False,
) -> None:
    """Serve until SIGINT (Ctrl-C), SIGTERM or SIGHUP, then shut down gracefully. Call it from the main thread.

    Args:
        hands: as in `Server`.
        listen: as in `Server`.
        config: as in `Server`.
        on_ready: as in `ServeOptions`.
        insecure: as in `Server`.
        secure: as in `Server`.
        grace: as in `ServeOptions`, s.
        end_process: as in `ServeOptions`.

    Raises:
        UnknownName: a hand does not exist.
        ModelError: a hand cannot be read.
        InvalidInput: as in `Server`.
        ServiceError: the address is in use or invalid.
    """
    server = Server(hands, listen=listen, config=config, insecure=insecure, secure=secure)
    run_server(server, ServeOptions(on_ready=on_ready, grace=grace, end_process=end_process))


def run_server(server: Server, options: ServeOptions) -> None:
    """Start a server and serve until SIGINT (Ctrl-C), SIGTERM or SIGHUP, then shut down gracefully.

    Call it from the main thread. The server leaves the replicas, closes its streams, and answers or refuses the waiting
    requests. A second signal ends the wait for answers. In a systemd unit with ``Type=notify`` the process reports when it is
    ready, and resets the watchdog while the server is healthy.

    Args:
        server: the server; it does not run yet.
        options: how to serve.

    Raises:
        ServiceError: an address is in use or invalid.
        InvalidInput: the address of the metrics is invalid, or the system does not permit real-time scheduling.
    """
    deadline, received = Deadline(math.inf), list[int]()

    def on_signal(number: int, frame: FrameType | None) -> None:
        received.append(number)
        deadline.limit(options.grace if len(received) == 1 else 0.0)
        if options.end_process and len(received) > 1:
            _end_process()

    previous = {number: signal.signal(number, on_signal) for number in _SIGNALS}
    one_thread = threadpool_limits(1)  # small matrices gain nothing from more, which would take processors from streams
    switch_interval = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    if options.end_process:
        share_heap()
    manager, monitoring, attached = ServiceManager(), None, ExitStack()
    try:
        server.start()
        if options.metrics is not None:
            monitoring = _start_monitoring(options.metrics, server)
        if options.attach is not None:
            attached.enter_context(options.attach(server))
        gc.collect()
        gc.freeze()  # a full collection would pause all streams
        if options.on_ready is not None:
            options.on_ready(server)
        manager.ready("serving")
        files, checked, collected = HandFiles(options.watch, server.reload_hand), time.monotonic(), time.monotonic()
        while not received:
            time.sleep(_SIGNAL_CHECK_PERIOD)  # a wait without end could miss a signal that arrives just before it
            if time.monotonic() - checked > _WATCH_PERIOD:
                files.check()
                checked = time.monotonic()
            if time.monotonic() - collected > _COLLECT_PERIOD:
                gc.collect()  # fast, because most objects are frozen; it also frees the unused tuples that Python keeps
                collected = time.monotonic()
            if manager.is_alive_due() and (problem := server.load().problem) is None:
                manager.alive()
            elif manager.is_alive_due():
                log.error("the server is not healthy: %s", problem)
        manager.stopping()
        log.info("answering the waiting requests for at most %g s; a second signal ends the wait", options.grace)
    finally:
        deadline.limit(options.grace)
        if options.end_process and received:
            threading.Thread(target=_end_process, args=(deadline,), name="end", daemon=True).start()
        attached.close()
        server.close(deadline)
        if options.end_process and received:
            _end_process()
        if monitoring is not None:
            monitoring.close()
        sys.setswitchinterval(switch_interval)
        one_thread.restore_original_limits()
        gc.unfreeze()
        for number, handler in previous.items():
            signal.signal(number, handler)


def _start_monitoring(address: str, server: Server) -> MonitoringServer:
    """Serve metrics, health and readiness over HTTP.

    Raises:
        MissingLibrary: prometheus-client is not installed.
        InvalidInput: the address is invalid.
        ServiceError: the address is in use.
    """
    with optional_imports():
        from graspforce.service.server.monitoring import MonitoringServer
    return MonitoringServer(address, server.status)


def _end_process(deadline: Deadline | None = None) -> None:
    """End the process with exit code 0, without Python's finalisation: a thread in a solver would abort it.

    Args:
        deadline: wait until `_END_DELAY` after it; None for no wait.
    """
    if deadline is not None:
        time.sleep(deadline.remaining + _END_DELAY)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):  # closed, or a full disk
            continue
    os._exit(0)
