"""Floods of requests by one client beside a polite client: `python -m benchmarks.flood`.

The polite client asks for the solution of a small force problem 20 times a second, one request at a time. A client in another
process sends as many requests as it can, and has up to 2000 requests without an answer, or 500 where the table says so. Each
flood has a quiet time before it, which states the polite client's usual latency.

A refused request is replaced at once. The time to a refusal therefore contains the client's own backlog: its requests without
an answer, divided by the answers per second. With four times fewer requests it is about four times shorter. "Zenoh alone" is
the same flood against a queryable that refuses every request at once, without a service or a second client. It is the part of
the time that Zenoh and the flooding client need.

"answered" is the share of the polite client's requests that are solved in time during the flood. "recovery" is the time from
the end of the flood until the first of five consecutive polite requests that each take at most the 99 % quantile of the quiet
time: later slow requests, which a shared machine has at any time, do not count. Memory is that of the server and its worker and
planning processes, which start with the server. The planning processes keep the equations of a
hand from its first plan on: this is the growth after the flood of plans.
"""

from __future__ import annotations

import contextlib
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks import report_page
from benchmarks.service_load import (
    TIMEOUT,
    Load,
    LoadResult,
    ServerUnderTest,
    start_bare_refusals,
    start_client,
    start_server,
)
from graspforce import problems
from graspforce.core.errors import ServiceError
from graspforce.service import Client

RATE = 20.0  # polite requests per second
BUDGET = 1.0  # s, of a request
_WINDOW = 5  # requests
FLOODS = {
    "one client": Load("solve", outstanding=2000, budget=BUDGET),
    "one client, 500 requests": Load("solve", outstanding=500, budget=BUDGET),
    "a thousand names of one client": Load("solve", outstanding=2000, names=1000, budget=BUDGET),
    "a thousand names, 500 requests": Load("solve", outstanding=500, names=1000, budget=BUDGET),
    "4 MB messages": Load("4 MB", outstanding=50, budget=BUDGET),
    "streams": Load("streams", outstanding=50, budget=BUDGET),
    "plans": Load("plans", outstanding=50, budget=BUDGET),
}


@dataclass(frozen=True, slots=True)
class Polite:
    """Requests of the polite client.

    Args:
        begun: when each request began, on the clock `time.perf_counter`, s.
        seconds: time of each request, s.
        solved: whether each was solved in time.
        memory: of the server when each was answered, MiB.
    """

    begun: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    solved: list[bool] = field(default_factory=list)
    memory: list[float] = field(default_factory=list)


def ask(client: Client, server: ServerUnderTest, seconds: float, is_ended: threading.Event | None = None) -> Polite:
    """Send polite requests for a time, and as long as an event has not happened."""
    problem, polite = problems.load("ring/3-force").problem, Polite()
    start = tick = time.perf_counter()
    while time.perf_counter() - start < seconds or (is_ended is not None and not is_ended.is_set()):
        begun = time.perf_counter()
        solved = False
        with contextlib.suppress(ServiceError):
            solved = client.solve(problem, budget=BUDGET).found
        polite.begun.append(begun)
        polite.seconds.append(time.perf_counter() - begun)
        polite.solved.append(solved)
        polite.memory.append(server.memory())
        tick = max(tick + 1.0 / RATE, time.perf_counter())
        time.sleep(max(tick - time.perf_counter(), 0.0))
    return polite


def recovery(polite: Polite, end: float, longest: float) -> float:
    """Return the time until the first of `_WINDOW` consecutive requests that take at most a time, s; NaN if there are none.

    Args:
        polite: requests after a flood.
        end: end of the flood, on the clock `time.perf_counter`, s.
        longest: largest time of such a request, s.
    """
    is_usual = [seconds <= longest for seconds in polite.seconds]
    for i in range(len(is_usual) - _WINDOW + 1):
        if all(is_usual[i : i + _WINDOW]):
            return max(polite.begun[i] - end, 0.0)
    return float("nan")


def time_bare_refusals(load: Load, seconds: float) -> float:
    """Return the 99 % quantile of the times of a load to refusals of Zenoh alone, s.

    Args:
        load: the load.
        seconds: time of the load, s.
    """
    with start_bare_refusals() as address, start_client(address) as flooder:
        flooder.start(load)
        time.sleep(seconds)
        return flooder.stop().quantile(0.99, "overloaded")


def measure(name: str, seconds: float) -> tuple[str, ...]:
    """Return the row of a flood."""
    with start_server() as server, Client(server.address, timeout=TIMEOUT) as client:
        quiet = ask(client, server, seconds)
        with start_client(server.address) as flooder:
            flooder.start(FLOODS[name])
            flooded = ask(client, server, seconds)
            end, stopped, results = time.perf_counter(), threading.Event(), list[LoadResult]()

            def stop() -> None:
                results.append(flooder.stop())
                stopped.set()

            threading.Thread(target=stop).start()
            after = ask(client, server, seconds, stopped)
    bare = time_bare_refusals(FLOODS[name], seconds)
    usual = float(np.median(quiet.seconds))
    before = quiet.memory[-1]
    [result] = results
    return (
        name,
        str(result),
        f"{1e3 * result.quantile(0.99, 'overloaded'):.0f}" if result.count("overloaded") else "–",
        f"{1e3 * bare:.0f}",
        f"{100.0 * np.mean(flooded.solved):.0f} %",
        f"{1e3 * usual:.1f}",
        f"{1e3 * np.median(flooded.seconds):.1f}",
        f"{1e3 * np.quantile(flooded.seconds, 0.99):.0f}",
        f"{recovery(after, end, float(np.quantile(quiet.seconds, 0.99))):.2f}",
        f"{before:.0f}",
        f"{max(flooded.memory + after.memory) - before:+.0f}",
        f"{after.memory[-1] - before:+.0f}",
    )


def _show(rows: list[tuple[str, ...]], save: Path | None) -> None:
    """Print the table and write the page."""
    polite = ("answered", "usual ms", "median ms", "99 % ms")
    memory = ("memory before, MiB", "largest growth", "growth after")
    head = ("flood", "answers", "99 % of `overloaded` ms", "Zenoh alone ms", *polite, "recovery s", *memory)
    report_page.publish("Floods of requests beside a polite client", __doc__, head, rows, save, text_columns=2, width=200)


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("flood", __doc__)
    parser.add_argument("--seconds", type=float, default=6.0, help="time of a flood, and of the quiet times around it, s")
    parser.add_argument("--flood", action="append", choices=list(FLOODS), help="flood to measure; repeatable (default: all)")
    options = parser.parse_args()
    _show([measure(name, options.seconds) for name in options.flood or FLOODS], options.save)


if __name__ == "__main__":
    main()
