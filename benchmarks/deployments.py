"""Round trips of a stream in the reference configurations: `python -m benchmarks.deployments`.

The driver steps a stream of a server on the same machine, in bursts that take turns: over a connection to the server (one
robot), through a Zenoh router that the server has joined (a cell), and over a connection with TLS and access control (a fleet).
"ratio" compares the medians with that of the direct connection in the same run.
"""

from __future__ import annotations

import contextlib
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import zenoh

from benchmarks import report_page
from benchmarks.control_stream import allegro_grasp, state_sequence
from benchmarks.replicas import ROUTER
from benchmarks.service_load import HAND, TIMEOUT, python_process, read_line
from graspforce.control import ControlSettings
from graspforce.service import Client
from graspforce.service.client.stream import Stream
from graspforce.service.security.directory import init_directory
from graspforce.service.zenoh_session import build_configuration, find_addresses

BURST, WARM_UP = 50, 10  # round trips, and those of them that are not timed
PERIOD = 1e-3  # s
LOCAL = "tcp/127.0.0.1:0"


def start_router(stack: contextlib.ExitStack) -> str:
    """Start a router in this process and return its endpoint."""
    config = build_configuration(ROUTER, {}, {"listen/endpoints": [LOCAL], "adminspace/enabled": True})
    return find_addresses(stack.enter_context(zenoh.open(config)), config)[0]


def start_server(stack: contextlib.ExitStack, *options: str) -> str:
    """Start a server in a process of its own and return its endpoint."""
    command = ("graspforce", "serve", "--hand", HAND, "--worker-threads", "--json", *options)
    return str(json.loads(read_line(stack.enter_context(python_process(*command))))["addresses"][0])


def measure(rounds: int) -> dict[str, list[float]]:
    """Return the times of the round trips by configuration, s."""
    grasp = allegro_grasp()
    points = state_sequence(grasp, BURST)
    times: dict[str, list[float]] = {}
    with contextlib.ExitStack() as stack:
        keys = init_directory(Path(stack.enter_context(tempfile.TemporaryDirectory())) / "keys")
        router = start_router(stack)
        start_server(stack, "--listen", LOCAL, "--connect", router)
        secure = start_server(stack, "--listen", "tls/127.0.0.1:0", "--secure", str(keys))
        clients = {
            "one robot: direct": Client(start_server(stack, "--listen", LOCAL), timeout=TIMEOUT),
            "a cell: through a router": Client(router, timeout=TIMEOUT),
            "a fleet: TLS and roles": Client(secure, secure=keys, timeout=TIMEOUT),
        }
        streams: dict[str, Stream] = {}
        for name, client in clients.items():
            stack.enter_context(client)
            stream = client.open_stream(grasp, ControlSettings(), validity=TIMEOUT)
            streams[name] = stack.enter_context(stream)
        for _ in range(rounds):
            for name, stream in streams.items():
                times.setdefault(name, []).extend(_burst(stream, points))
    return times


def _burst(stream: Stream, points: list[tuple[object, object]]) -> list[float]:
    """Return the times of a burst of round trips, s."""
    times, tick = [], time.perf_counter()
    for state, desired in points:
        tick = max(tick + PERIOD, time.perf_counter())
        time.sleep(max(tick - time.perf_counter(), 0.0))
        begun = time.perf_counter()
        stream.step(state, desired, wait=TIMEOUT)  # type: ignore[arg-type]
        times.append(time.perf_counter() - begun)
    return times[WARM_UP:]


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("deployments", __doc__)
    parser.add_argument("--rounds", type=int, default=40, help="bursts of each configuration")
    options = parser.parse_args()
    times = measure(options.rounds)
    direct = float(np.median(next(iter(times.values()))))
    head = ("configuration", "median µs", "90 %", "99 %", "largest", "ratio")
    rows = []
    for name, own in times.items():
        figures = np.quantile(own, [0.5, 0.9, 0.99, 1.0])
        rows.append((name, *(f"{1e6 * each:.0f}" for each in figures), f"{figures[0] / direct:.2f}"))
    report_page.publish("Reference configurations", __doc__, head, rows, options.save)


if __name__ == "__main__":
    main()
