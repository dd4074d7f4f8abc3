"""A client that never reads its replies, beside a polite one: `python -m benchmarks.unread_client`.

A client sends queries whose replies have hundreds of kilobytes, and is frozen before it reads them. The buffers of its
connection fill up, and the server closes the connection after half a second (`wait_before_close`). In the meantime, a polite
client asks for the status and solves force problems, one request at a time. The server has graspforce's configuration, or a
file that sets something else.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import zenoh
from zenoh.handlers import Callback

from benchmarks import report_page
from benchmarks.service_load import LOCAL, TIMEOUT, python_process, read_line
from graspforce import problems
from graspforce.service import Client
from graspforce.service.wire import protocol
from graspforce.service.zenoh_session import build_configuration

QUERIES = 400  # of the client that does not read: some 100 MB of replies, more than the buffers of a connection
FILE = "{transport: {link: {rx: {max_message_size: 9000000}}}}"
CONFIGURATIONS = ("", FILE)


def measure(text: str, seconds: float) -> list[float]:
    """Return the times of the polite client's requests, s, from the moment that the other one is frozen.

    Args:
        text: a Zenoh configuration of the server; empty for none.
        seconds: for how long.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "server.json5"
        file.write_text(text)
        options = ["--config", str(file)] if text else []
        command = ("graspforce", "serve", "--hand", "four_finger", "--listen", LOCAL, "--worker-threads", "--json", *options)
        with python_process(*command) as server:
            address = json.loads(read_line(server))["addresses"][0]
            with (
                python_process("benchmarks.unread_client", "ask", address) as unread,
                Client(address, timeout=TIMEOUT) as client,
            ):
                assert read_line(unread) == "asked"
                unread.send_signal(signal.SIGSTOP)
                os.waitid(os.P_PID, unread.pid, os.WSTOPPED | os.WNOWAIT)
                try:
                    return _ask_politely(client, seconds)
                finally:
                    unread.kill()


def _ask_politely(client: Client, seconds: float) -> list[float]:
    """Send requests in turn for a time, and return how long each took, s."""
    problem, times = problems.load("ring/3-force").problem, list[float]()
    start = begun = time.monotonic()
    while begun - start < seconds:
        client.status()
        assert client.solve(problem).found
        times.append(time.monotonic() - begun)
        begun = time.monotonic()
    return times


def _ask_without_reading(address: str) -> None:
    """Send queries for all schemas, and wait to be frozen."""
    with zenoh.open(build_configuration(None, {"mode": "client"}, {"connect/endpoints": [address]})) as session:
        for _ in range(QUERIES):
            session.get(f"{protocol.PREFIX}/schema/**", Callback(lambda reply: None), timeout=60.0)
        print("asked", flush=True)
        sys.stdin.read()


def _show(rows: Sequence[tuple[str, ...]], save: Path | None) -> None:
    """Print the table and write the page."""
    head = ("configuration file of the server", "polite requests", "median ms", "99 % ms", "longest s", "bound s")
    report_page.publish("A client that does not read its replies", __doc__, head, rows, save)


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("unread_client", __doc__)
    parser.add_argument("--seconds", type=float, default=4.0, help="time of each run, s")
    options = parser.parse_args()
    rows = []
    for text in CONFIGURATIONS:
        times = measure(text, options.seconds)
        median, p99 = np.quantile(times, [0.5, 0.99])
        name = "with one" if text else "none"
        rows.append((name, str(len(times)), f"{1e3 * median:.1f}", f"{1e3 * p99:.0f}", f"{max(times):.3f}", "0.6"))
    _show(rows, options.save)


if __name__ == "__main__":
    if sys.argv[1:2] == ["ask"]:
        _ask_without_reading(sys.argv[2])
    else:
        main()
