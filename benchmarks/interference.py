"""Latency of a control stream beside ordinary requests: `python -m benchmarks.interference`.

This process steps a stream at 1 kHz against `graspforce serve`. In each period it also makes a round trip to a bare echo in a
third process, behind a ring buffer of one message. The echo shares the machine but not the server. A fourth process sends
requests. Bursts with each load and without load take turns, and so do servers with worker processes and with worker threads, so
that a drift of the machine's speed affects all of them equally. Requests have a budget of 3 s.

A ratio compares the 99 % quantile of a load with that without load in the same run. "over 1 ms" is the share of round trips
that take longer than a period: a driver that does not wait would skip these states.

The relayed echo is an echo whose messages pass through the server's Zenoh session: this is the way of the messages of a stream
that steps in a process of its own.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from zenoh.handlers import RingChannel

from benchmarks import report_page
from benchmarks.control_stream import TIMEOUT, allegro_grasp, state_sequence
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.grasp.grasp import Grasp
from graspforce.service import Client, Stream
from graspforce.service.wire import protocol
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.zenoh_session import build_configuration

HAND = "allegro_right"
LOCAL = "tcp/127.0.0.1:0"
BURST = 500  # periods of a burst
WARM_UP = 50  # periods of a burst that are not timed
PERIOD = 1e-3  # s
STATE_BYTES, COMMAND_BYTES = 741, 1659  # of the stream's messages, for the echo
SERVERS = {"processes": ["--worker-processes"], "threads": ["--worker-threads"]}
RATES = {"control": 50.0, "distribute, 400 contacts": 20.0, "open and close": 10.0, "8 MB": 1.0, "100 MB": 1.0}  # requests/s
BUDGET = 3.0  # s, of a request
FLOOD = "flood"  # of small requests
FLOOD_OUTSTANDING = 200  # requests without an answer
NOTHING = "nothing"
LOADS = (NOTHING, *RATES, FLOOD)
SERIES = ("stream", "echo")
RELAY = "relay"


def large_problem(grasp: Grasp, count: int) -> dict[str, object]:
    """Return the request to distribute the weight of an object over many contacts near those of a grasp."""
    rng, n = np.random.default_rng(1), len(grasp.fingers)
    points = grasp.contacts.p_OC[np.arange(count) % n] + 0.004 * rng.standard_normal((count, 3))  # m
    points *= 0.03 / np.linalg.norm(points, axis=1)[:, None]  # on the ball
    contacts = [
        {"position": p.tolist(), "normal": (-p / 0.03).tolist(), "friction": 0.7, "finger": grasp.fingers[i % n]}
        for i, p in enumerate(points)
    ]
    pose = {"position": grasp.p_HO.tolist(), "rotation": grasp.R_HO.tolist()}
    return {"posture": grasp.q.tolist(), "object": pose, "contacts": contacts, "wrench": [0, 0, 0.5, 0, 0, 0]}


def control_request(grasp: Grasp) -> dict[str, object]:
    """Return the request of one control step at rest."""
    pose = {"position": grasp.p_HO.tolist(), "rotation": grasp.R_HO.tolist()}
    hold = StreamSetup(grasp, ControlSettings()).to_dict()["hold"]
    return {"hold": hold, "state": {"posture": grasp.q.tolist(), "object": pose}, "desired": pose}


class Load:
    """Requests of one kind, from a thread, until it is stopped.

    Args:
        session: an open session.
        kind: one of `LOADS`.
    """

    def __init__(self, session: zenoh.Session, kind: str) -> None:
        self._session, self._kind = session, kind
        self.outcomes: Counter[str] = Counter()
        self._stopped, self._free = threading.Event(), threading.Semaphore(FLOOD_OUTSTANDING)
        self._requests = _make_requests(kind)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def stop(self) -> dict[str, int]:
        """Stop, wait for the answers, and return the number of answers by outcome."""
        self._stopped.set()
        self._thread.join()
        for _ in range(FLOOD_OUTSTANDING):
            self._free.acquire(timeout=TIMEOUT)
        return dict(self.outcomes)

    def _run(self) -> None:
        rate, start, count = RATES.get(self._kind), time.perf_counter(), 0
        while not self._stopped.is_set() and self._kind != NOTHING:
            for key, payload in self._requests:
                self._send(key, payload)
            count += 1
            if rate is not None:
                self._stopped.wait(max(start + count / rate - time.perf_counter(), 0.0))

    def _send(self, key: str, payload: bytes) -> None:
        self._free.acquire()
        answered: list[str] = []

        def count(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                answered.append("ok")
            elif str(reply.err.encoding) == protocol.MSGPACK:
                answered.append(protocol.decode(reply.err.payload.to_bytes(), protocol.MSGPACK)["error"])
            else:
                answered.append("late")  # Zenoh's own error record

        def done() -> None:
            self.outcomes[answered[0] if answered else "no reply"] += 1
            self._free.release()

        attachment = f"{self._session.zid()}".encode()
        callback = zenoh.handlers.Callback(count, done)
        self._session.get(
            f"{protocol.PREFIX}/{key}",
            callback,
            payload=payload,
            encoding=protocol.MSGPACK,
            attachment=attachment,
            timeout=TIMEOUT,
        )


def _make_requests(kind: str) -> list[tuple[str, bytes]]:
    """Return keys and payloads of the requests of one turn."""
    grasp = allegro_grasp()
    setup = {**StreamSetup(grasp, ControlSettings()).to_dict()}
    records: dict[str, list[tuple[str, Any]]] = {
        NOTHING: [],
        "control": [(f"hands/{HAND}/control", control_request(grasp))],
        "distribute, 400 contacts": [(f"hands/{HAND}/distribute", large_problem(grasp, 400))],
        "open and close": [("streams/load", setup), ("streams/load", {"close": True})],
        "8 MB": [("solve", {"x": "y" * 8_000_000})],
        "100 MB": [("solve", {"x": "y" * 100_000_000})],
        FLOOD: [(f"hands/{HAND}/control", control_request(grasp))],
    }
    return [(key, protocol.encode({**record, "budget": BUDGET}, protocol.MSGPACK)) for key, record in records[kind]]


def run_loads(address: str) -> None:
    """Start the load that each line of standard input names; an empty line stops it and prints the outcomes."""
    with zenoh.open(build_configuration(None, {"mode": "client"}, {"connect/endpoints": [address]})) as session:
        print("ready", flush=True)
        load: Load | None = None
        for line in sys.stdin:
            if line.strip():
                load = Load(session, line.strip())
                print("started", flush=True)
            elif load is not None:
                print(json.dumps(load.stop()), flush=True)


def run_echo(server: str) -> None:
    """Answer each message with one of a command's size, behind a ring buffer, until standard input closes.

    Args:
        server: endpoint of a server whose session relays the messages; empty to listen.
    """
    settings = {"connect/endpoints": [server]} if server else {"listen/endpoints": [LOCAL], "adminspace/enabled": True}
    with zenoh.open(build_configuration(None, {"mode": "client" if server else "peer"}, settings)) as session:
        command = session.declare_publisher("echo/command", congestion_control=zenoh.CongestionControl.DROP)
        states = session.declare_subscriber("echo/state", RingChannel(1))

        def run() -> None:
            with contextlib.suppress(zenoh.ZError):
                while True:
                    states.handler.recv()
                    command.put(b"x" * COMMAND_BYTES)

        thread = threading.Thread(target=run)
        thread.start()
        locators = [server]
        if not server:
            [reply] = session.get(f"@/{session.zid()}/*", timeout=TIMEOUT)
            locators = json.loads(reply.ok.payload.to_bytes())["locators"]
        print(locators[0], flush=True)
        sys.stdin.read()
        states.undeclare()
        thread.join()


class Echo:
    """The driver's end of the echo.

    Args:
        address: endpoint of the echo.
    """

    def __init__(self, address: str) -> None:
        self._session = zenoh.open(build_configuration(None, {"mode": "client"}, {"connect/endpoints": [address]}))
        self._state = self._session.declare_publisher("echo/state", congestion_control=zenoh.CongestionControl.DROP)
        self._command = self._session.declare_subscriber("echo/command", RingChannel(1))

    def step(self) -> None:
        """Make one round trip."""
        self._state.put(b"x" * STATE_BYTES)
        self._command.handler.recv()

    def close(self) -> None:
        """Close the session."""
        self._session.close()


def burst(subjects: dict[str, Callable[[int], Any]]) -> dict[str, list[float]]:
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


@contextlib.contextmanager
def _process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [sys.executable, "-m", *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        try:
            yield child
        finally:
            child.terminate()


def _read_line(child: subprocess.Popen[str]) -> str:
    assert child.stdout is not None
    return child.stdout.readline().strip()


def _send_line(child: subprocess.Popen[str], line: str) -> None:
    assert child.stdin is not None
    child.stdin.write(line + "\n")
    child.stdin.flush()


def measure(servers: list[str], loads: list[str], rounds: int) -> tuple[dict[Any, Any], dict[Any, Counter[str]]]:
    """Return the times of the round trips by server, load and series, s, and the answers by server and load."""
    grasp = allegro_grasp()
    points, settings = state_sequence(grasp, BURST), ControlSettings()
    trips: dict[Any, list[float]] = {}
    outcomes: dict[Any, Counter[str]] = {}
    with contextlib.ExitStack() as stack:
        echo = Echo(_read_line(stack.enter_context(_process("benchmarks.interference", "--echo", ""))))
        stack.callback(echo.close)
        clients, loaders = {}, {}
        for name in servers:
            options = ["--hand", HAND, "--listen", LOCAL, "--json", *SERVERS[name]]
            address = json.loads(_read_line(stack.enter_context(_process("graspforce", "serve", *options))))["addresses"][0]
            clients[name] = stack.enter_context(Client(address, timeout=30.0))
            loaders[name] = stack.enter_context(_process("benchmarks.interference", "--load", address))
            assert _read_line(loaders[name]) == "ready"
            stack.enter_context(_process("benchmarks.interference", "--echo", address))
            _warm_up(loaders[name])
        relay = Echo(address)
        stack.callback(relay.close)
        for _ in range(rounds):
            subjects: dict[str, Callable[[int], Any]] = {"echo": lambda i: echo.step(), "relay": lambda i: relay.step()}
            for series, own in burst(subjects).items():
                trips.setdefault((RELAY, NOTHING, series), []).extend(own)
            for load in loads:
                for name in servers:
                    _send_line(loaders[name], load)
                    assert _read_line(loaders[name]) == "started"
                    with clients[name].open_stream(grasp, settings, validity=TIMEOUT) as stream:
                        step = partial(_step, stream, points)
                        for series, own in burst({"stream": step, "echo": lambda i: echo.step()}).items():
                            trips.setdefault((name, load, series), []).extend(own)
                    _send_line(loaders[name], "")
                    outcomes.setdefault((name, load), Counter()).update(json.loads(_read_line(loaders[name])))
    return trips, outcomes


def _step(stream: Stream, points: list[tuple[GraspState, BodyMotion]], i: int) -> None:
    """Make one round trip of a stream."""
    stream.step(*points[i], wait=TIMEOUT)


def _warm_up(loader: subprocess.Popen[str]) -> None:
    """Send requests of all classes, so that the worker processes have started."""
    for load in ("control", "distribute, 400 contacts"):
        _send_line(loader, load)
        _read_line(loader)
        time.sleep(3.0)
        _send_line(loader, "")
        _read_line(loader)


def rows_of(trips: dict[Any, list[float]], outcomes: dict[Any, Counter[str]]) -> list[tuple[str, ...]]:
    """Return the rows of the table."""
    rows = []
    for name, load in outcomes:
        cells = [name, load]
        for each in SERIES:
            own, idle = np.array(trips[name, load, each]), np.array(trips[name, NOTHING, each])
            p50, p99, largest = 1e3 * np.percentile(own, [50, 99, 100])
            ratio = np.percentile(own, 99) / np.percentile(idle, 99)
            over = 100.0 * np.mean(own > PERIOD)
            cells += [f"{p50:.2f}", f"{p99:.2f}", f"{ratio:.2f}", f"{over:.1f} %", f"{largest:.1f}"]
        answers = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes[name, load].items()))
        rows.append((*cells, answers or "–"))
    return rows


def main() -> None:
    """Measure, print the table and write the page; or run one of the other processes."""
    parser = report_page.parser("interference", __doc__)
    parser.add_argument("--rounds", type=int, default=10, help="bursts of each server and load")
    parser.add_argument("--server", action="append", choices=list(SERVERS), help="server to measure (default: all); repeatable")
    parser.add_argument("--loads", action="append", choices=LOADS[1:], help="load to measure (default: all); repeatable")
    parser.add_argument("--load", help=argparse.SUPPRESS)
    parser.add_argument("--echo", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.load:
        run_loads(options.load)
    elif options.echo is not None:
        run_echo(options.echo)
    else:
        trips, outcomes = measure(options.server or list(SERVERS), [NOTHING, *(options.loads or LOADS[1:])], options.rounds)
        _show(trips, outcomes, options.save)


def _show(trips: dict[Any, list[float]], outcomes: dict[Any, Counter[str]], save: Path | None) -> None:
    rows = rows_of(trips, outcomes)
    figures = ("p50 ms", "p99 ms", "ratio", "over 1 ms", "max ms")
    head = ("server", "load", *(f"{each} {figure}" for each in SERIES for figure in figures), "answers")
    title = "Latency of a control stream beside ordinary requests"
    report_page.show(title, head, rows, width=200)
    direct, relayed = (1e6 * np.percentile(trips[RELAY, NOTHING, each], [50, 99]) for each in ("echo", "relay"))
    relay = (
        f"An echo takes {direct[0]:.0f} µs (median; 99 %: {direct[1]:.0f} µs), relayed by a server {relayed[0]:.0f} µs "
        f"({relayed[1]:.0f} µs): {relayed[0] / direct[0]:.2f} times as long."
    )
    print(relay)
    if save is not None:
        count = min(len(own) for own in trips.values())
        facts = report_page.facts(f"{os.cpu_count()} cores", f"{count} round trips per row")
        tables = report_page.table(head, rows, text_columns=2)
        report_page.save(save, title, __doc__, facts, f"{tables}\n\n{relay}")


if __name__ == "__main__":
    main()
