"""A control stream beside other streams of a real-time server: `python -m benchmarks.other_streams`.

This process steps a stream at 1 kHz against `graspforce serve --realtime 10`. In each period it also makes a round trip to a
bare echo in another process. This process, server and echo have the same real-time priority. A fourth process steps four more
streams, whose period and rate differ from row to row. It has a lower real-time priority, so that it gets the time that the
others leave, as a client on another machine would. Rows take turns, so that a drift of the machine's speed affects all of them
equally.

Slower streams have a lower priority. Streams that exceed their declared period have that of requests. So have streams beyond
the server's limit on the states a second of all real-time streams, `realtime_states`. One server has the default of this
limit, another one a limit that no row reaches.

Linux stops all real-time threads of a processor for 50 ms if they have used it for 950 ms of a second, which the fourth process
may do.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks import report_page
from benchmarks.control_stream import allegro_grasp, state_sequence
from benchmarks.service_load import TIMEOUT, Echo, ServerUnderTest, python_process, read_line, start_echo, start_server
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.core.errors import GraspForceError
from graspforce.grasp.grasp import Grasp
from graspforce.service import Client, Stream, StreamState, use_realtime_scheduling
from graspforce.service.realtime_scheduling import DEFAULT_PRIORITY, end_realtime_scheduling
from graspforce.service.server.limits import ServerLimits
from graspforce.service.wire import protocol

COUNT = 4  # other streams
LIMITS = (ServerLimits().realtime_states, 10**6)  # states a second
PERIOD = 1e-3  # s, of the measured stream
POINTS = 500  # states that are repeated
SEND = "send"  # role of the process of the other streams
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
        shares: of a processor for the server's process, in each turn.
        rates: states a second of all other streams that the server answered, in each turn.
    """

    stream: list[float] = field(default_factory=list)
    echo: list[float] = field(default_factory=list)
    shares: list[float] = field(default_factory=list)
    rates: list[float] = field(default_factory=list)


def _send_states(address: str, count: int, period: float, declared: float) -> None:
    """Send states to several streams in turn until standard input closes. The commands are not read."""
    grasp, ended = allegro_grasp(), threading.Event()
    still = BodyMotion(grasp.p_HO, grasp.R_HO)
    state = StreamState(0, 0.0, GraspState(grasp.q, np.zeros(grasp.hand.n), still), still, binary=True)
    payload = state.encode(protocol.MSGPACK)
    with Client(address, timeout=TIMEOUT) as client, contextlib.ExitStack() as stack:
        settings = ControlSettings(period=declared)
        streams = [stack.enter_context(client.open_stream(grasp, settings)) for _ in range(count)]
        print("ready", flush=True)
        threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
        use_realtime_scheduling(1)
        tick = time.perf_counter()
        for stream in itertools.cycle(streams):
            if ended.is_set():
                break
            stream._connection.send(payload)  # without the work of `step`, which would limit the rate
            tick = max(tick + period / count, time.perf_counter())
            time.sleep(max(tick - time.perf_counter(), 0.0))


@contextlib.contextmanager
def _start_sender(address: str, period: float, declared: float) -> Iterator[None]:
    """Send states to the other streams from another process.

    Args:
        address: endpoint of the server.
        period: time between two states of each stream, s.
        declared: control period of their settings, s.
    """
    with python_process("benchmarks.other_streams", SEND, address, str(COUNT), str(period), str(declared)) as child:
        assert read_line(child) == "ready"
        yield


def _processor_time(pid: int) -> float:
    """Return the processor time of a process, s."""
    numbers = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(numbers[11]) + int(numbers[12])) * _TICK


def _count_states(client: Client, stream: Stream) -> int:
    """Return the number of states of the other open streams that the server has answered."""
    others = (each for each in client.status().active_streams if each.id != stream.id)
    return sum(each.outcomes.get("ok", 0) for each in others)


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


@dataclass(frozen=True, slots=True)
class Turn:
    """A turn of a row.

    Args:
        row: the other streams.
        server: the server.
        client: of the server.
        echo: the echo.
    """

    row: Others
    server: ServerUnderTest
    client: Client
    echo: Echo

    def run(self, grasp: Grasp, points: list[tuple[GraspState, BodyMotion]], seconds: float, trips: Trips) -> None:
        """Step the stream and the echo for a time, and add the measurements."""
        row, client = self.row, self.client
        with client.open_stream(grasp, ControlSettings(), validity=TIMEOUT) as stream, contextlib.ExitStack() as others:
            if row.declared is not None:
                others.enter_context(_start_sender(self.server.address, row.period, row.declared))
            begun, used, answered = time.perf_counter(), _processor_time(self.server.pid), _count_states(client, stream)
            use_realtime_scheduling()
            try:
                _drive(stream, points, self.echo, seconds, trips)
            finally:
                end_realtime_scheduling()
            elapsed = time.perf_counter() - begun  # s
            trips.shares.append((_processor_time(self.server.pid) - used) / elapsed)
            trips.rates.append((_count_states(client, stream) - answered) / elapsed)


Measured = dict[tuple[int, str], Trips]  # by limit of the server and name of the row


def measure(rounds: int, seconds: float) -> Measured:
    """Return all measurements.

    Args:
        rounds: turns of each row.
        seconds: time of a turn, s.
    """
    grasp, measured = allegro_grasp(), {(limit, row.name): Trips() for row in ROWS for limit in LIMITS}
    points, priority = state_sequence(grasp, POINTS), str(DEFAULT_PRIORITY)
    with contextlib.ExitStack() as stack:
        limited = {limit: ("--realtime", priority, "--limit", f"realtime_states={limit}") for limit in LIMITS}
        servers = {limit: stack.enter_context(start_server(*options)) for limit, options in limited.items()}
        clients = {limit: stack.enter_context(Client(each.address, timeout=TIMEOUT)) for limit, each in servers.items()}
        echo = stack.enter_context(start_echo(realtime=DEFAULT_PRIORITY))
        for row, limit in itertools.product(ROWS * rounds, LIMITS):
            turn = Turn(row, servers[limit], clients[limit], echo)
            turn.run(grasp, points, seconds, measured[limit, row.name])
    return measured


def rows_of(measured: Measured) -> list[tuple[str, ...]]:
    """Return the rows of the table."""
    rows = []
    for (limit, name), trips in measured.items():
        stream, echo = np.array(trips.stream), np.array(trips.echo)
        times = 1e3 * np.concatenate([np.quantile(stream, [0.5, 0.99, 1.0]), np.quantile(echo, [0.5, 0.99])])
        ratio = float(np.quantile(stream, 0.99) / np.quantile(echo, 0.99))
        over = 100.0 * float(np.mean(stream > PERIOD))
        share, rate = 100.0 * float(np.mean(trips.shares)), float(np.mean(trips.rates))
        rows.append(
            (name, str(limit), f"{rate:.0f}", *(f"{t:.2f}" for t in times), f"{ratio:.2f}", f"{over:.1f} %", f"{share:.0f} %")
        )
    return rows


def _show(measured: Measured, save: Path | None) -> None:
    """Print the table and write the page."""
    head = (
        "four other streams",
        "limit states/s",
        "their states/s",
        *("stream ms", "99 %", "largest", "echo ms", "99 %", "99 % / 99 %", "over 1 ms"),
        "processor of the server",
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
    parser.add_argument("--rounds", type=int, default=3, help="turns of each row")
    parser.add_argument("--seconds", type=float, default=5.0, help="time of a turn, s")
    options = parser.parse_args()
    try:
        _show(measure(options.rounds, options.seconds), options.save)
    except GraspForceError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    if sys.argv[1:2] == [SEND]:
        _send_states(sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), float(sys.argv[5]))
    else:
        main()
