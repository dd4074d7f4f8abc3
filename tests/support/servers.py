"""Servers in child processes, plain Zenoh sessions, and waiting, for the tests of the service."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import zenoh

from graspforce.service.zenoh_session import build_configuration

ANY_LOCAL_PORT = "tcp/127.0.0.1:0"  # any free port
TIMEOUT = 20.0  # s, enough for a busy machine; only a failing test waits so long

SERVER_SCRIPT = """
import sys
from graspforce.service import serve
serve(sys.argv[2:], listen=sys.argv[1], on_ready=lambda server: print(server.addresses[0], flush=True))
print("closed", flush=True)
"""

ChildProcess = contextlib.AbstractContextManager[tuple[subprocess.Popen[str], str]]


@contextlib.contextmanager
def python_process(script: str, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run a Python script in a child process, yield it with the first line of its output, and kill it at the end."""
    with subprocess.Popen([sys.executable, "-c", script, *arguments], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        try:
            yield child, child.stdout.readline().strip()
        finally:
            child.kill()


def server_process(*hands: str, listen: str = ANY_LOCAL_PORT) -> ChildProcess:
    """Run a server in a child process and yield it with its address. It prints "closed" after a graceful shutdown."""
    return python_process(SERVER_SCRIPT, listen, *hands)


def plain_session(address: str) -> zenoh.Session:
    """Open a Zenoh session without graspforce's client."""
    return zenoh.open(build_configuration(None, {"mode": "client", "connect/endpoints": [address]}, {}))


def get(session: zenoh.Session, key: str, payload: Any = None, encoding: Any = None) -> list[tuple[bool, str, bytes]]:
    """Return (ok, encoding, payload) of each reply to a query."""
    replies = []
    every = zenoh.ConsolidationMode.NONE
    for reply in session.get(f"graspforce/1/{key}", payload=payload, encoding=encoding, timeout=TIMEOUT, consolidation=every):
        content = reply.ok or reply.err
        replies.append((reply.ok is not None, str(content.encoding), content.payload.to_bytes()))
    return replies


def suspend(child: subprocess.Popen[str]) -> None:
    """Stop a child process, and wait until all its threads have stopped."""
    child.send_signal(signal.SIGSTOP)
    os.waitpid(child.pid, os.WUNTRACED)


def wait_until(is_met: Callable[[], object]) -> None:
    """Wait until a condition is met, or fail."""
    deadline = time.monotonic() + TIMEOUT
    while not is_met():
        assert time.monotonic() < deadline, "the condition was not met in time"
        time.sleep(0.01)
