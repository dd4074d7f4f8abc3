"""Services that run while a test does, in this process or one of their own, and plain Zenoh sessions at them."""

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
PATIENCE = 20.0  # s: long enough for a busy machine; no test waits for it unless it fails

SERVER_SCRIPT = """
import sys
from graspforce.service import serve
serve(sys.argv[2:], listen=sys.argv[1], on_ready=lambda server: print(server.addresses[0], flush=True))
print("closed", flush=True)
"""

ChildProcess = contextlib.AbstractContextManager[tuple[subprocess.Popen[str], str]]


@contextlib.contextmanager
def python_process(script: str, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A Python process, and the first line that it says; killed in the end."""
    with subprocess.Popen([sys.executable, "-c", script, *arguments], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        try:
            yield child, child.stdout.readline().strip()
        finally:
            child.kill()


def server_process(*hands: str, listen: str = ANY_LOCAL_PORT) -> ChildProcess:
    """A server in a process of its own, and its address; it says "closed" when it ends in order."""
    return python_process(SERVER_SCRIPT, listen, *hands)


def plain_session(address: str) -> zenoh.Session:
    """As another program's would be."""
    return zenoh.open(build_configuration(None, {"mode": "client", "connect/endpoints": [address]}, {}))


def get(session: zenoh.Session, key: str, payload: Any = None, encoding: Any = None) -> list[tuple[bool, str, bytes]]:
    """(ok, encoding, payload) of every reply to a query."""
    replies = []
    every = zenoh.ConsolidationMode.NONE
    for reply in session.get(f"graspforce/1/{key}", payload=payload, encoding=encoding, timeout=PATIENCE, consolidation=every):
        said = reply.ok or reply.err
        replies.append((reply.ok is not None, str(said.encoding), said.payload.to_bytes()))
    return replies


def suspend(child: subprocess.Popen[str]) -> None:
    """Stop a process of ours, and wait until all its threads stand still: the signal alone may come a moment late."""
    child.send_signal(signal.SIGSTOP)
    os.waitpid(child.pid, os.WUNTRACED)


def wait_until(is_met: Callable[[], object]) -> None:
    """Wait for something to hold: a client sees its server's end, for one, a moment after the end of the process."""
    deadline = time.monotonic() + PATIENCE
    while not is_met():
        assert time.monotonic() < deadline, "it never held"
        time.sleep(0.01)
