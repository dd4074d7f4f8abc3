"""The service under load for ten minutes: `python -m benchmarks.soak`, or `make soak`.

This process steps a stream at 1 kHz against `graspforce serve`. In each period it also makes a round trip to a bare echo in
another process, behind a ring buffer of one message. A third process steps four more streams at 250 Hz, a fourth sends 50
requests a second (control steps, force problems, status), a fifth plans a move every two seconds. The table compares the stream
with the echo of the same run, and the open files and threads of the server in the last tenth of the time with those in the
second tenth, by their medians. Memory, open files and threads are those of the server's process and of its worker and planning
processes. Skipped states are the server's own count: states that newer ones replaced before they were read.

Where the system permits it, server and driver have real-time scheduling (`graspforce serve --realtime 10`); `--ordinary` turns
it off. All other processes are ordinary: the load, the workers of the server, and the bare echo. In every second period the
round trip is to a second echo with the same real-time priority as the server; the table has both comparisons.

The growth of the memory is that of its second half, by the median slope between two samples (Theil and Sen). The memory of a
process grows in steps while its threads meet larger amounts of work for the first time, and then stays. A line of least squares
takes one step of a MiB for a leak; the median slope shows a growth that continues.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy import stats

from benchmarks import report_page
from benchmarks.control_stream import allegro_grasp, state_sequence
from benchmarks.service_load import (
    TIMEOUT,
    Echo,
    Load,
    LoadResult,
    ServerUnderTest,
    may_use_realtime_scheduling,
    start_client,
    start_echo,
    start_server,
    start_streams,
)
from graspforce.control import ControlSettings
from graspforce.core.arrays import Array
from graspforce.service import Client, use_realtime_scheduling
from graspforce.service.realtime_scheduling import DEFAULT_PRIORITY

PERIOD = 1e-3  # s
SLOW_STREAMS, SLOW_PERIOD = 4, 4e-3  # s
REQUESTS = Load("mixed", rate=50.0)
PLANS = Load("plans", rate=0.5, outstanding=1, budget=2.0)
LATE = 20e-3  # s
BARE, REALTIME = "echo", "real-time echo"
POINTS = 500  # states that are repeated


@dataclass(frozen=True, slots=True)
class Samples:
    """Measurements of a run.

    Args:
        stream: times of the stream's round trips, s.
        server: parts of them in the server, s.
        echo: times of the round trips of each echo by its name, s.
        times: when the resources were read, s.
        memory: of the server's process, MiB.
        files: its open files.
        threads: its threads.
        all_memory: of all its processes, MiB.
        skipped: states that the server skipped, of all streams.
    """

    stream: list[float] = field(default_factory=list)
    server: list[float] = field(default_factory=list)
    echo: dict[str, list[float]] = field(default_factory=dict)
    times: list[float] = field(default_factory=list)
    memory: list[float] = field(default_factory=list)
    files: list[int] = field(default_factory=list)
    threads: list[int] = field(default_factory=list)
    all_memory: list[float] = field(default_factory=list)
    skipped: list[int] = field(default_factory=list)


def drive(client: Client, echoes: Mapping[str, Echo], server: ServerUnderTest, seconds: float) -> Samples:
    """Step the stream and the echoes in turn for a time."""
    grasp, samples = allegro_grasp(), Samples(echo={name: [] for name in echoes})
    turns = itertools.cycle(echoes.items())
    points = state_sequence(grasp, POINTS)
    start = tick = time.perf_counter()
    with client.open_stream(grasp, ControlSettings(), validity=TIMEOUT) as stream:
        i = 0
        while (begun := time.perf_counter()) - start < seconds:
            command = stream.step(*points[i % POINTS], wait=TIMEOUT)
            name, echo = next(turns)
            middle = time.perf_counter()
            echo.step()
            samples.echo[name].append(time.perf_counter() - middle)
            samples.stream.append(middle - begun)
            samples.server.append(command.server_seconds)
            i += 1
            if begun - start >= len(samples.times):  # once a second, on a slow machine too
                samples.times.append(time.perf_counter() - start)
                samples.memory.append(server.own_memory())
                samples.all_memory.append(server.memory())
                samples.files.append(server.files())
                samples.threads.append(server.threads())
            tick = max(tick + PERIOD, time.perf_counter())
            time.sleep(max(tick - time.perf_counter(), 0.0))
        samples.skipped.append(sum(each.skipped for each in client.status().active_streams if each.id == stream.id))
    return samples


def memory_slope(times: Sequence[float], memory: Sequence[float]) -> float:
    """Return the growth of a memory in the second half of a run, MiB/h; 0 for fewer than three samples.

    Args:
        times: when each sample was taken, s.
        memory: the samples, MiB.
    """
    half = np.array(times) >= 0.5 * times[-1]
    if np.sum(half) < 3:
        return 0.0
    return 3600.0 * float(stats.theilslopes(np.array(memory)[half], np.array(times)[half]).slope)


Row = tuple[str, str, str, str]  # quantity, measured value, bound, and whether it is met


def _row(quantity: str, value: str, bound: str, is_met: bool) -> Row:
    return quantity, value, bound, "yes" if is_met else "no"


def judge(samples: Samples, requests: LoadResult, plans: LoadResult) -> list[Row]:
    """Return the rows of the table."""
    unanswered, count = _count_unanswered(requests, plans), len(samples.stream)
    rows = [
        _row(
            "requests without an answer, late, or `internal`",
            f"{unanswered} of {requests.count() + plans.count()}",
            "0",
            unanswered == 0,
        )
    ]
    for name, times in samples.echo.items():
        rows += _compare(samples, name, np.array(times))
    slope, all_slope = (memory_slope(samples.times, each) for each in (samples.memory, samples.all_memory))  # MiB/h
    return [
        *rows,
        _row(
            "states of the stream that the server skipped",
            f"{samples.skipped[-1]} of {count}",
            "0.5 %",
            samples.skipped[-1] <= 0.005 * count,
        ),
        _row(
            "memory of all processes of the server",
            f"{samples.all_memory[-1]:.0f} MiB, {all_slope:+.1f} MiB/h",
            "+1 MiB/h",
            all_slope <= 1.0,
        ),
        _row("memory of the server's process", f"{samples.memory[-1]:.0f} MiB, {slope:+.1f} MiB/h", "+1 MiB/h", slope <= 1.0),
        _flat_row("open files", samples.files),
        _flat_row("threads", samples.threads),
    ]


def _compare(samples: Samples, name: str, echo: Array) -> list[Row]:
    """Return the rows that compare the stream with an echo."""
    stream = np.array(samples.stream)
    transport = float(np.median(stream) - np.median(samples.server))  # s
    over = 100.0 * float(np.mean(stream > PERIOD) - np.mean(echo > PERIOD))  # points
    late = float(np.mean(stream > LATE)), float(np.mean(echo > LATE))
    median, p99 = float(np.median(echo)), float(np.quantile(stream, 0.99) / np.quantile(echo, 0.99))
    whole = float(np.median(stream)) / median
    return [
        _row(f"stream over 1 ms, more than the {name}", f"{over:.1f} points", "2", over <= 2.0),
        _row(
            f"stream without its part in the server / {name}, median",
            f"{transport / median:.2f}",
            "1.3",
            transport <= 1.3 * median,
        ),
        _row(f"stream / {name}, median", f"{whole:.2f}", "2", whole <= 2.0),
        _row(f"stream / {name}, 99 %", f"{p99:.2f}", "1.5", p99 <= 1.5),
        _row(
            f"round trips over 20 ms, stream and {name}",
            f"{np.sum(stream > LATE)} of {len(stream)} and {np.sum(echo > LATE)} of {len(echo)}",
            "as many",
            late[0] <= late[1],
        ),
    ]


def _flat_row(quantity: str, counts: Sequence[int]) -> Row:
    """Return the row of a number that must not grow from the second to the last tenth of the run."""
    tenth = max(len(counts) // 10, 1)
    begin, end = float(np.median(counts[tenth : 2 * tenth] or counts[:1])), float(np.median(counts[-tenth:]))
    return _row(f"{quantity} at begin and end", f"{begin:g} and {end:g}", "no more", end <= begin)


def _count_unanswered(*results: LoadResult) -> int:
    """Return the number of requests without an answer of the server, or with the error `internal`."""
    return sum(result.count(outcome) for result in results for outcome in ("no reply", "late", "internal"))


def measure(seconds: float, realtime: bool) -> tuple[Samples, LoadResult, LoadResult]:
    """Return the measurements, and the answers to requests and plans."""
    options = ("--realtime", str(DEFAULT_PRIORITY)) if realtime else ()
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(start_server(*options))
        echoes = {BARE: stack.enter_context(start_echo())}
        if realtime:
            echoes[REALTIME] = stack.enter_context(start_echo(realtime=DEFAULT_PRIORITY))
        client = stack.enter_context(Client(server.address, timeout=TIMEOUT))
        requests, plans = (stack.enter_context(start_client(server.address)) for _ in range(2))
        stack.enter_context(start_streams(server.address, SLOW_STREAMS, SLOW_PERIOD))
        requests.start(REQUESTS)
        plans.start(PLANS)
        if realtime:
            use_realtime_scheduling()
        samples = drive(client, echoes, server, seconds)
        return samples, requests.stop(), plans.stop()


def _show(samples: Samples, requests: LoadResult, plans: LoadResult, save: Path | None) -> None:
    """Print the table and write the page."""
    rows = judge(samples, requests, plans)
    head = ("quantity", "measured", "bound", "met")
    title = "The service under load"
    report_page.show(title, head, rows)
    figures = {"stream": samples.stream, "part in the server": samples.server, **samples.echo}
    parts = [[name, *(f"{1e6 * x:.0f}" for x in np.quantile(own, [0.5, 0.9, 0.99, 1.0]))] for name, own in figures.items()]
    times = report_page.table(("round trips", "median µs", "90 %", "99 %", "largest"), parts)
    answers = f"Requests: {requests}. Plans: {plans}. Without an answer: {_count_unanswered(requests, plans)}."
    print(times, answers, sep="\n\n")
    if save is not None:
        facts = report_page.facts(
            f"{os.cpu_count()} cores", f"load average {os.getloadavg()[0]:.1f}", f"{samples.times[-1]:.0f} s"
        )
        report_page.save(save, title, __doc__, facts, "\n\n".join([report_page.table(head, rows, 4), times, answers]))


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("soak", __doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="time of the run, s")
    parser.add_argument("--ordinary", action="store_true", help="no real-time scheduling of server and driver")
    options = parser.parse_args()
    realtime = not options.ordinary and may_use_realtime_scheduling()
    _show(*measure(options.seconds, realtime), options.save)


if __name__ == "__main__":
    main()
