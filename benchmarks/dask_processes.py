"""A scheduler and workers of Dask, each in its own process."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def scheduler(folder: Path) -> Iterator[str]:
    """Run a scheduler of Dask in its own process, and yield its address.

    Args:
        folder: existing folder for the file with the address.
    """
    file = folder / "scheduler.json"
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    process = subprocess.Popen([*command, "--scheduler-file", str(file)], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    try:
        while not file.exists() or not file.read_text().strip().endswith("}"):
            assert process.poll() is None
            time.sleep(0.05)
        yield json.loads(file.read_text())["address"]
    finally:
        process.kill()
        process.wait()


@contextmanager
def worker(address: str, name: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a worker with one thread in its own process, and yield the process.

    Args:
        address: address of the scheduler.
        name: name of the worker.
    """
    command = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--name", name]
    process = subprocess.Popen([*command, "--no-dashboard"], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()
