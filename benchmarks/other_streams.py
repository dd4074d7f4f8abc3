"""A control stream beside other streams of a real-time server: `python -m benchmarks.other_streams`.

This process steps a stream at 1 kHz against `graspforce serve --realtime 10`. In each period it also makes a round trip to a
bare echo in another process. This process, server and echo have the same real-time priority. An ordinary process steps four
more streams, whose period and rate differ from row to row. Another ordinary process computes all the time: its share of a
processor shows what the real-time threads leave for other programs. Rows take turns, so that a drift of the machine's speed
affects all of them equally.

Slower streams have a lower priority. Streams that exceed their declared period, and streams beyond the limit `realtime_states`
of the server, have that of requests.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks import report_page
from benchmarks.control_stream import allegro_grasp, state_sequence
from benchmarks.service_load import TIMEOUT, Echo, start_echo, start_server, start_streams
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.core.errors import GraspForceError
from graspforce.service import Client, Stream, use_realtime_scheduling
from graspforce.service.realtime_scheduling import DEFAULT_PRIORITY, end_realtime_scheduling

COUNT = 4  # other streams
PERIOD = 1e-3  # s, of the measured stream
POINTS = 500  # states that are repeated
_TICK = 1.0 / os.sysconf("SC_CLK_TCK")  # s


@dataclass(frozen=True, slots=True)
class Others:
    """The other streams of a row.

    Args:
        name: of the row.
        declared: their control period, s; None for no other streams.
        period: time between two of their states, s.
    """

    name: str
    declared: float | None = None
    period: float = 0.0


ROWS = (
    Others("none"),
    Others("250 Hz", 4e-3, 4e-3),
    Others("1 kHz", 1e-3, 1e-3),
    Others("2.5 kHz", 4e-4, 4e-4),
    Others("2.5 kHz, declared as 1 kHz", 1e-3, 4e-4),
    Others("2.5 kHz, declared as 250 Hz", 4e-3, 4e-4),
)


@dataclass(frozen=True, slots=True)
class Trips:
    """Measurements of a row.

    Args:
        stream: times of the stream's round trips, s.
        echo: times of the echo's round trips, s.
        shares: of a processor for the ordinary process, in each turn.
    """

    stream: list[float] = field(default_factory=list)
    echo: list[float] = field(default_factory=list)
    shares: list[float] = field(default_factory=list)


@contextlib.contextmanager
def _ordinary_program() -> Iterator[int]:
    """Run a process that computes all the time, and return its number."""
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as child:
        try:
            yield child.pid
        finally:
            child.kill()


def _processor_time(pid: int) -> float:
    """Return the processor time of a process, s."""
    numbers = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(numbers[11]) + int(numbers[12])) * _TICK


def _drive(stream: Stream, points: list[tuple[GraspState, BodyMotion]], echo: Echo, seconds: float, trips: Trips) -> None:
    """Step stream and echo once a period for a time."""
    start = tick = time.perf_counter()
    for i in range(int(seconds / PERIOD)):
        begun = time.perf_counter()
        if begun - start > seconds:
            return
        stream.step(*points[i % POINTS], wait=TIMEOUT)
        middle = time.perf_counter()
        echo.step()
        trips.echo.append(time.perf_counter() - middle)
        trips.stream.append(middle - begun)
        tick = max(tick + PERIOD, time.perf_counter())
        time.sleep(max(tick - time.perf_counter(), 0.0))


def measure(rounds: int, seconds: float) -> dict[str, Trips]:
    """Return the measurements by the name of the row.

    Args:
        rounds: turns of each row.
        seconds: time of a turn, s.
    """
    grasp, measured = allegro_grasp(), {row.name: Trips() for row in ROWS}
    points = state_sequence(grasp, POINTS)
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(start_server("--realtime", str(DEFAULT_PRIORITY)))
        echo = stack.enter_context(start_echo(realtime=DEFAULT_PRIORITY))
        client = stack.enter_context(Client(server.address, timeout=TIMEOUT))
        pid = stack.enter_context(_ordinary_program())
        for row in ROWS * rounds:
            with contextlib.ExitStack() as turn:
                stream = turn.enter_context(client.open_stream(grasp, ControlSettings(), validity=TIMEOUT))
                if row.declared is not None:
                    turn.enter_context(start_streams(server.address, COUNT, row.period, row.declared))
                begun, used = time.perf_counter(), _processor_time(pid)
                use_realtime_scheduling()
                try:
                    _drive(stream, points, echo, seconds, measured[row.name])
                finally:
                    end_realtime_scheduling()
                measured[row.name].shares.append((_processor_time(pid) - used) / (time.perf_counter() - begun))
    return measured


def rows_of(measured: dict[str, Trips]) -> list[tuple[str, ...]]:
    """Return the rows of the table."""
    rows = []
    for name, trips in measured.items():
        stream, echo = np.array(trips.stream), np.array(trips.echo)
        times = 1e3 * np.concatenate([np.quantile(stream, [0.5, 0.99, 1.0]), np.quantile(echo, [0.5, 0.99])])
        ratio = float(np.quantile(stream, 0.99) / np.quantile(echo, 0.99))
        over = 100.0 * float(np.mean(stream > PERIOD))
        share = 100.0 * float(np.mean(trips.shares))
        rows.append((name, *(f"{t:.2f}" for t in times), f"{ratio:.2f}", f"{over:.1f} %", f"{share:.0f} %"))
    return rows


def _show(measured: dict[str, Trips], save: Path | None) -> None:
    """Print the table and write the page."""
    head = (
        "four other streams",
        *("stream ms", "99 %", "largest", "echo ms", "99 %", "99 % / 99 %", "over 1 ms"),
        "ordinary program",
    )
    rows, title = rows_of(measured), "A control stream beside other streams"
    report_page.show(title, head, rows, width=140)
    if save is not None:
        count = min(len(trips.stream) for trips in measured.values())
        facts = report_page.facts(
            f"{os.cpu_count()} cores", f"{count} round trips per row", f"load average {os.getloadavg()[0]:.1f}"
        )
        report_page.save(save, title, __doc__, facts, report_page.table(head, rows))


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("other_streams", __doc__)
    parser.add_argument("--rounds", type=int, default=4, help="turns of each row")
    parser.add_argument("--seconds", type=float, default=5.0, help="time of a turn, s")
    options = parser.parse_args()
    try:
        _show(measure(options.rounds, options.seconds), options.save)
    except GraspForceError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
