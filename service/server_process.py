"""A service in a process of its own, for those who want one at hand: the demo, the simulated driver, benchmarks."""

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

_MAX_ERROR_CHARACTERS = 2000  # characters of an error: the end tells what happened
_START_TIMEOUT = 30.0  # s: a cold machine imports for several seconds


@dataclass(frozen=True, eq=False, slots=True)
class ServerProcess:
    """A service that runs.

    Attributes:
        address: the Zenoh endpoint at which it listens.
        process: where it runs.
    """

    address: str
    process: subprocess.Popen[str]


@contextmanager
def start_server_process(hand: str, address: str | None = None) -> Iterator[ServerProcess]:
    """Start a service, wait until it answers, and end it in order.

    Args:
        hand: the hand that it serves: a shipped one's name, or a description file.
        address: the Zenoh endpoint to listen on; by default a free port of this machine.

    Raises:
        ServiceError: it ended, or did not answer in time.
    """
    address = address or f"tcp/127.0.0.1:{_free_port()}"
    command = [sys.executable, "-m", "graspforce", "serve", "--hand", hand, "--listen", address]
    with (
        tempfile.TemporaryFile(
            "w+", errors="replace"
        ) as stderr_file,  # a pipe that nobody reads is full after 64 KiB, and stops it
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=stderr_file, text=True, env=dict(os.environ)) as server,
    ):
        try:
            _wait_until_ready(address, server, stderr_file)
            yield ServerProcess(address, server)
        finally:
            server.terminate()
            try:
                server.wait(timeout=10.0)
            except subprocess.TimeoutExpired:
                server.kill()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _wait_until_ready(address: str, server: subprocess.Popen[str], stderr_file: IO[str]) -> None:
    """Return once the service answers; what it said goes into the error where it does not."""
    deadline = time.monotonic() + _START_TIMEOUT
    while time.monotonic() < deadline:
        if server.poll() is not None:
            stderr_file.seek(0)
            raise ServiceError(
                f"the service ended with exit code {server.returncode}: {stderr_file.read()[-_MAX_ERROR_CHARACTERS:].strip()}"
            )
        try:
            with Client(address, timeout=1.0) as client:
                if client.servers():
                    return
        except (NoServer, ServiceError):
            pass
        time.sleep(0.05)
    raise ServiceError(f"the service did not answer on {address} within {_START_TIMEOUT:g} s")
