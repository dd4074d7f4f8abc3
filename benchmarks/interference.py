"""Latency of a control stream beside ordinary requests: `python -m benchmarks.interference`.

This process steps a stream at 1 kHz against `graspforce serve`. In each period it also makes a round trip to a bare echo in a
third process, behind a ring buffer of one message. The echo shares the machine but not the server. A fourth process sends
requests. Bursts with each load and without load take turns, and so do the servers, so that a drift of the machine's speed
affects all of them equally. Requests have a budget of 3 s; later ones are refused with `deadline`.

One server has worker processes, one has worker threads. Where the system permits it, a third one has worker processes and
real-time scheduling (`graspforce serve --realtime 10`). Its driver and the echo of its rows then have it as well.

A ratio compares the 99 % quantile of a load with that without load in the same run. "over 1 ms" is the share of round trips
that take longer than a period: a driver that does not wait would skip these states.

The relayed echo is an echo whose messages pass through the server's Zenoh session: this is the way of the messages of a stream
that steps in a process of its own.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks import report_page
from benchmarks.control_stream import allegro_grasp, state_sequence
from benchmarks.service_load import (
    TIMEOUT,
    Echo,
    Load,
    LoadResult,
    may_use_realtime_scheduling,
    start_client,
    start_echo,
    start_server,
)
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.service import Client, Stream, use_realtime_scheduling
from graspforce.service.realtime_scheduling import DEFAULT_PRIORITY, end_realtime_scheduling

BURST = 500  # periods of a burst
WARM_UP = 50  # periods of a burst that are not timed
PERIOD = 1e-3  # s
REALTIME = "real-time"
SERVERS = {
    "processes": ("--worker-processes",),
    "threads": ("--worker-threads",),
    REALTIME: ("--worker-processes", "--realtime", str(DEFAULT_PRIORITY)),
}
NOTHING = "nothing"
LOADS = {
    NOTHING: None,
    "50 control/s": Load("control", 50.0),
    "20 distribute/s, 400 contacts": Load("distribute", 20.0),
    "20 open + close/s": Load("open and close", 40.0),
    "8 MB/s": Load("8 MB", 1.0),
    "100 MB/s": Load("100 MB", 1.0),
    "flood of control": Load("control"),
}
SERIES = ("stream", "echo")
RELAY = "relay"

Trips = dict[tuple[str, str, str], list[float]]  # by server, load and series, s
Subjects = dict[str, Callable[[int], None]]


def burst(subjects: Subjects) -> dict[str, list[float]]:
    """Return the times of the round trips of one burst by subject, s. Each period has a round trip of each subject."""
    trips: dict[str, list[float]] = {name: [] for name in subjects}
    tick = time.perf_counter()
    for i in range(BURST):
        tick = max(tick + PERIOD, time.perf_counter())
        time.sleep(max(tick - time.perf_counter(), 0.0))
        for name, step in subjects.items():
            start = time.perf_counter()
            step(i)
            if i >= WARM_UP:
                trips[name].append(time.perf_counter() - start)
    return trips


def _step(stream: Stream, points: list[tuple[GraspState, BodyMotion]], i: int) -> None:
    """Make one round trip of a stream."""
    stream.step(*points[i], wait=TIMEOUT)


def _step_echo(echo: Echo, i: int) -> None:
    """Make one round trip of an echo."""
    echo.step()


@contextlib.contextmanager
def _scheduling_of(server: str) -> Iterator[None]:
    """Give this process real-time scheduling in a ``with`` block if the server has it."""
    if server == REALTIME:
        use_realtime_scheduling()
    try:
        yield
    finally:
        if server == REALTIME:
            end_realtime_scheduling()


def measure(servers: list[str], loads: list[str], rounds: int) -> tuple[Trips, dict[tuple[str, str], LoadResult]]:
    """Return the times of all round trips, and the answers to the requests by server and load."""
    grasp = allegro_grasp()
    points, settings = state_sequence(grasp, BURST), ControlSettings()
    trips: Trips = {}
    answers: dict[tuple[str, str], LoadResult] = {(name, load): LoadResult() for load in loads for name in servers}
    with contextlib.ExitStack() as stack:
        addresses = {name: stack.enter_context(start_server(*SERVERS[name])).address for name in servers}
        echo, relay = (stack.enter_context(start_echo(server)) for server in ("", addresses[servers[0]]))
        echoes = dict.fromkeys(servers, echo)
        if REALTIME in servers:
            echoes[REALTIME] = stack.enter_context(start_echo(realtime=DEFAULT_PRIORITY))
        clients = {name: stack.enter_context(Client(address, timeout=TIMEOUT)) for name, address in addresses.items()}
        senders = {name: stack.enter_context(start_client(address)) for name, address in addresses.items()}
        for _ in range(rounds):
            pair: Subjects = {"echo": partial(_step_echo, echo), RELAY: partial(_step_echo, relay)}
            for series, own in burst(pair).items():
                trips.setdefault((RELAY, NOTHING, series), []).extend(own)
            for name, load in answers:
                requests = LOADS[load]
                if requests is not None:
                    senders[name].start(requests)
                with clients[name].open_stream(grasp, settings, validity=TIMEOUT) as stream, _scheduling_of(name):
                    pair = {"stream": partial(_step, stream, points), "echo": partial(_step_echo, echoes[name])}
                    for series, own in burst(pair).items():
                        trips.setdefault((name, load, series), []).extend(own)
                if requests is not None:
                    answers[name, load].add(senders[name].stop())
    return trips, answers


def rows_of(trips: Trips, answers: dict[tuple[str, str], LoadResult]) -> list[tuple[str, ...]]:
    """Return the rows of the table."""
    rows = []
    for (name, load), result in answers.items():
        cells = [name, load]
        for each in SERIES:
            own, idle = np.array(trips[name, load, each]), np.array(trips[name, NOTHING, each])
            p50, p99, largest = 1e3 * np.percentile(own, [50, 99, 100])
            ratio = np.percentile(own, 99) / np.percentile(idle, 99)
            over = 100.0 * np.mean(own > PERIOD)
            cells += [f"{p50:.2f}", f"{p99:.2f}", f"{ratio:.2f}", f"{over:.1f} %", f"{largest:.1f}"]
        rows.append((*cells, str(result)))
    return rows


def _show(trips: Trips, answers: dict[tuple[str, str], LoadResult], save: Path | None) -> None:
    """Print the table and write the page."""
    rows = rows_of(trips, answers)
    figures = ("p50 ms", "p99 ms", "ratio", "over 1 ms", "max ms")
    head = ("server", "load", *(f"{each} {figure}" for each in SERIES for figure in figures), "answers")
    title = "Latency of a control stream beside ordinary requests"
    report_page.show(title, head, rows, width=200)
    direct, relayed = (1e6 * np.percentile(trips[RELAY, NOTHING, each], [50, 99]) for each in ("echo", RELAY))
    relay = (
        f"An echo takes {direct[0]:.0f} µs (median; 99 %: {direct[1]:.0f} µs), relayed by a server {relayed[0]:.0f} µs "
        f"({relayed[1]:.0f} µs): {relayed[0] / direct[0]:.2f} times as long."
    )
    print(relay)
    if save is not None:
        counts = f"{min(len(own) for own in trips.values())} round trips per row, load average {os.getloadavg()[0]:.1f}"
        facts = report_page.facts(f"{os.cpu_count()} cores", counts)
        report_page.save(save, title, __doc__, facts, f"{report_page.table(head, rows, text_columns=2)}\n\n{relay}")


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("interference", __doc__)
    parser.add_argument("--rounds", type=int, default=10, help="bursts of each server and load")
    parser.add_argument(
        "--server", action="append", choices=list(SERVERS), help="server to measure; repeatable (default: all that may run)"
    )
    parser.add_argument("--load", action="append", choices=list(LOADS)[1:], help="load to measure; repeatable (default: all)")
    options = parser.parse_args()
    loads = [NOTHING, *(options.load or list(LOADS)[1:])]
    servers = options.server or [name for name in SERVERS if name != REALTIME or may_use_realtime_scheduling()]
    _show(*measure(servers, loads, options.rounds), options.save)


if __name__ == "__main__":
    main()
