"""A control stream with a browser view beside it: `python -m benchmarks.view_beside_stream [--save FILE]`.

A driver at 1 kHz, a server in a second process, and every other round the view in a third one, which reads the stream as a
monitor. Rounds with and without the view take turns, so that a drift of the machine's speed affects both equally. The round
trip is `Stream.step`, from state to command. One page is open: a client of the view's web socket that receives all pictures
and draws none, with the lowest priority. A browser on this machine would draw without a graphics processor, and take the
processors from the stream. The processor time is that of the view for one picture, with all its threads. The requirements are
30 pictures a second, and a median that grows by at most 5 %.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from typing import Any, NamedTuple

import numpy as np

from benchmarks import report_page
from benchmarks.control_stream import allegro_grasp, state_sequence
from graspforce.control import ControlSettings
from graspforce.service import Client, Stream, start_server_process

PERIOD = 1e-3  # s
MAX_GROWTH, MIN_RATE = 5.0, 29.95  # %, pictures a second
_PORT = 8490
_VIEW = """
import io, json, signal, sys, time
from rich.console import Console
from graspforce.browser import StreamView, ViewAddress
from graspforce.cli import run_stream_view
shown, show = [], StreamView.show
def counted(self, *given):
    shown.append(time.monotonic())
    if len(shown) == 1:
        print("ready", flush=True)
    show(self, *given)
StreamView.show = counted
def used(*_):
    print(json.dumps([time.monotonic(), time.process_time(), len(shown)]), flush=True)
signal.signal(signal.SIGUSR1, used)
options = run_stream_view.StreamViewOptions(sys.argv[1], sys.argv[2], (), ViewAddress(port=int(sys.argv[4])))
run_stream_view.run(options, Console(file=io.StringIO()), float(sys.argv[3]))
"""
_PAGE = """
import os, sys
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
os.nice(19)
version = "viser-v" + viser.__version__
with connect(sys.argv[1], subprotocols=[version], compression=None, max_size=None) as socket:
    print("open", flush=True)
    try:
        while True:
            socket.recv()
    except ConnectionClosed:
        pass
"""


class Round(NamedTuple):
    """Round trips of a round, s, pictures a second of its view, and its processor time for one, s; 0 without."""

    trips: list[float]
    rate: float
    cost: float


def drive(stream: Stream, states: list[tuple[object, object]], seconds: float) -> list[float]:
    """Return the round trips at 1 kHz for a time.

    Args:
        stream: the open stream.
        states: states and desired motions, which are repeated.
        seconds: the time, s.
    """
    trips, start = [], time.perf_counter()
    for k in range(round(seconds / PERIOD)):
        while time.perf_counter() < start + k * PERIOD:
            pass
        before = time.perf_counter()
        stream.step(*states[k % len(states)])  # type: ignore[arg-type]
        trips.append(time.perf_counter() - before)
    return trips


def measure(stream: Stream, address: str, states: list[tuple[object, object]], seconds: float, with_view: bool) -> Round:
    """Return a round.

    Args:
        stream: the open stream.
        address: endpoint of the server.
        states: states and desired motions.
        seconds: time of a round, s.
        with_view: whether the view runs beside it.
    """
    if not with_view:
        drive(stream, states, 0.2)
        return Round(drive(stream, states, seconds), 0.0, 0.0)
    run = [sys.executable, "-c"]
    view_command = [*run, _VIEW, address, stream.id, str(seconds + 60.0), str(_PORT)]

    def line_of(process: subprocess.Popen[str]) -> str:
        """Return the next line of a process, while the stream runs."""
        assert process.stdout is not None
        os.set_blocking(process.stdout.fileno(), False)
        while not (line := process.stdout.readline()):
            drive(stream, states, 0.1)
        return line

    def use_of(view: subprocess.Popen[str]) -> Any:
        """Return the time, s, the processor time, s, and the number of pictures of the view."""
        view.send_signal(signal.SIGUSR1)
        return np.array(json.loads(line_of(view)))

    with subprocess.Popen(view_command, stdout=subprocess.PIPE, text=True) as view:
        line_of(view)
        page_command = [*run, _PAGE, f"ws://127.0.0.1:{_PORT}"]
        with subprocess.Popen(page_command, stdout=subprocess.PIPE, text=True) as page:
            line_of(page)
            drive(stream, states, 1.0)
            before = use_of(view)
            trips = drive(stream, states, seconds)
            elapsed, used, count = use_of(view) - before
            view.send_signal(signal.SIGINT)
            view.wait()
            page.wait()
    return Round(trips, count / elapsed, used / count)


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("view_beside_stream", __doc__)
    parser.add_argument("--rounds", type=int, default=5, help="rounds of each kind (default 5)")
    parser.add_argument("--seconds", type=float, default=6.0, help="time of a round, s (default 6)")
    options = parser.parse_args()
    grasp = allegro_grasp()
    states: list[tuple[object, object]] = list(state_sequence(grasp, 100))
    found: dict[bool, list[Round]] = {False: [], True: []}
    with (
        start_server_process("allegro_right") as server,
        Client(server.address) as client,
        client.open_stream(grasp, ControlSettings()) as stream,
    ):
        for _ in range(options.rounds):
            for with_view in (False, True):
                found[with_view].append(measure(stream, server.address, states, options.seconds, with_view))
    trips = {kind: 1e3 * np.concatenate([each.trips for each in rounds]) for kind, rounds in found.items()}  # ms
    rows = [
        ("with view" if kind else "alone", *(f"{np.quantile(trips[kind], q):.3f}" for q in (0.5, 0.9, 0.99)))
        for kind in (False, True)
    ]
    growth = 100.0 * (np.median(trips[True]) / np.median(trips[False]) - 1.0)
    rate = float(np.mean([each.rate for each in found[True]]))
    is_met = growth <= MAX_GROWTH and rate >= MIN_RATE
    cost = 1e3 * float(np.mean([each.cost for each in found[True]]))  # ms
    facts = f"The median grows by {growth:.1f} %, with {rate:.1f} pictures a second: {'met' if is_met else 'missed'}. "
    facts += f"The view takes {cost:.1f} ms of processor time for a picture."
    head = ("stream", "median ms", "90 % ms", "99 % ms")
    report_page.show("A view beside a stream at 1 kHz", head, rows)
    print(facts)
    if options.save is not None:
        about = report_page.facts(f"{os.cpu_count()} cores", f"load average {os.getloadavg()[0]:.1f}")
        report_page.save(options.save, "A view beside a stream", __doc__, f"{about} {facts}", report_page.table(head, rows))


if __name__ == "__main__":
    main()
