"""A server in a process of its own, for the demo, the simulated driver and benchmarks."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO

from graspforce.core.errors import NoServer, ServiceError
from graspforce.service.client.client import Client

_MAX_ERROR_CHARACTERS = 2000  # of the process's error output in a message; the end has the reason
_START_TIMEOUT = 30.0  # s; the first import on a machine takes several seconds
_STOP_TIMEOUT = 10.0  # s


@dataclass(frozen=True, eq=False, slots=True)
class ServerProcess:
    """A running server process.

    Attributes:
        address: Zenoh endpoint at which it listens.
        process: the process.
    """

    address: str
    process: subprocess.Popen[str]


@contextmanager
def start_server_process(hand: str, address: str | None = None) -> Iterator[ServerProcess]:
    """Start a server process, wait until it answers, and stop it at the end of the ``with`` block.

    Args:
        hand: name of a shipped hand, or path of a description file.
        address: Zenoh endpoint to listen on; by default a free local port.

    Raises:
        ServiceError: the process ended, or did not answer in time.
    """
    address = address or f"tcp/127.0.0.1:{_find_free_port()}"
    command = [sys.executable, "-m", "graspforce", "serve", "--hand", hand, "--listen", address]
    with (
        # a file, because an unread pipe blocks the process after 64 KiB
        tempfile.TemporaryFile("w+", errors="replace") as stderr_file,
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=stderr_file, text=True, env=dict(os.environ)) as server,
    ):
        try:
            _wait_until_ready(address, server, stderr_file)
            yield ServerProcess(address, server)
        finally:
            server.terminate()
            try:
                server.wait(timeout=_STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                server.kill()


def _find_free_port() -> int:
    """Return a free local TCP port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _wait_until_ready(address: str, server: subprocess.Popen[str], stderr_file: IO[str]) -> None:
    """Wait until the server answers. If the process ends first, raise its error output."""
    deadline = time.monotonic() + _START_TIMEOUT
    while time.monotonic() < deadline:
        if server.poll() is not None:
            stderr_file.seek(0)
            output = stderr_file.read()[-_MAX_ERROR_CHARACTERS:].strip()
            raise ServiceError(f"the server ended with exit code {server.returncode}: {output}")
        try:
            with Client(address, timeout=1.0) as client:
                if client.servers():
                    return
        except (NoServer, ServiceError):
            pass
        time.sleep(0.05)
    raise ServiceError(f"the server did not answer on {address} within {_START_TIMEOUT:g} s")
