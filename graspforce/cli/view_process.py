"""The view of a server's streams as a process beside it: it reads them as a monitor, with a lower priority than the server."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from graspforce.service.realtime_scheduling import ordinary_scheduling

_END_TIME = 0.5  # s, until a process that does not end is killed
_STANDARD_ERROR = 2  # its file descriptor: standard output has the results of `--json` only
_ANY_INTERFACE = "0.0.0.0"


@contextmanager
def view_process(address: str, hands: Sequence[str], secure: Path | None) -> Iterator[None]:
    """Run ``graspforce view`` in a process of its own, until the end of the ``with`` block. Its output is on standard error.

    Args:
        address: endpoint of the server.
        hands: names or description files of the served hands.
        secure: directory with certificates; None without TLS.
    """
    local = address.replace(_ANY_INTERFACE, "127.0.0.1" if secure is None else "localhost")
    command = [sys.executable, "-m", "graspforce", "view", "--connect", local]
    command += [part for hand in hands for part in ("--hand", hand)]
    command += [] if secure is None else ["--secure", str(secure)]
    with ordinary_scheduling():
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=_STANDARD_ERROR)
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(_END_TIME)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
