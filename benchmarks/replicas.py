"""Faults of replicas behind a Zenoh router: `python -m benchmarks.replicas`.

Two servers join a router, each over a link that can be cut and slowed. A driver at the router steps one stream. Then the server
of the stream is killed, frozen and thawed, drained by SIGTERM, or its link is cut, healed, slowed and made lossy. Servers that
ended start again, and join the router.

A lossy TCP link delays 10 % of its packets, and all after them, by a retransmission after 20 ms. A lossy UDP link loses 10 % of
its datagrams: states and commands that are lost are not repeated. Both add 5 to 15 ms each way.

"to notice" is the time from the fault until the watchdog of the driver is active, "to move" until the other replica's commands
arrive, and "to reach" until the torque has reached them. A dash: the driver's watchdog was never active. A stream whose link is
slow stays where it is, with late commands. "commands a state" is the largest number of commands that the router saw for one
state, also of the server that woke. The torque step is the largest change of a joint's torque per period while the watchdog is
active or the stream resumes, relative to its bound `Watchdog.step`. "late periods" is the share of the driver's periods since
the fault whose torque is the watchdog's.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import zenoh
from zenoh.handlers import Callback

from benchmarks import report_page
from benchmarks.link_relay import DatagramRelay, LinkRelay
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.core.arrays import Array
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp
from graspforce.hand.hand import Hand
from graspforce.service import Client, Watchdog
from graspforce.service.client.stream import Stream
from graspforce.service.wire import protocol
from graspforce.service.zenoh_session import build_configuration, find_addresses

HAND = "four_finger"
ROUTER = Path(__file__).parents[1] / "packaging/zenoh/router.json5"
PERIOD = 4e-3  # s, of the driver
TIMEOUT = 30.0  # s
SETTLE = 1.5  # s, after a fault is over: a server that woke would answer by then
WATCHDOG = Watchdog(hold=TIMEOUT)
LOCAL, DATAGRAMS = "tcp/127.0.0.1:0", "udp/127.0.0.1:0"
_OWNER_TIME = 0.1  # s, in which the owner of the stream sends commands
LOSS, LOSSY_DELAY, LOSSY_JITTER = 0.1, 5e-3, 1e-2  # share, s and s, of a lossy link


@dataclass(frozen=True, slots=True)
class Period:
    """One period of the driver.

    Args:
        time: when its torque was known, on the clock `time.monotonic`, s.
        late: whether the torque is the watchdog's.
        resuming: whether the torque moves back to the commands.
        tau: the torque, N·m.
    """

    time: float
    late: bool
    resuming: bool
    tau: Array


@dataclass(slots=True)
class Run:
    """What a driver and the router saw.

    Args:
        periods: the driver's periods.
        commands: number of commands by sequence number.
    """

    periods: list[Period] = field(default_factory=list)
    commands: Counter[int] = field(default_factory=Counter)

    @property
    def largest_step(self) -> float:
        """Largest change of a joint's torque per period while the watchdog is active or the stream resumes, N·m."""
        pairs = zip(self.periods, self.periods[1:], strict=False)
        steps = [np.abs(b.tau - a.tau).max() for a, b in pairs if b.late or b.resuming]
        return float(max(steps, default=0.0))

    def since(self, start: float, is_met: Callable[[Period], bool]) -> float:
        """Return the time from a start until a period meets a condition, s; NaN if none does."""
        return next((each.time - start for each in self.periods if each.time > start and is_met(each)), float("nan"))


class Replica:
    """A server process that has joined the router, maybe over a relayed link.

    Args:
        router: port of the router.
        kind: kind of the link, "tcp" or "udp".
    """

    def __init__(self, router: int, kind: str) -> None:
        self.link = DatagramRelay(router) if kind == "udp" else LinkRelay(router)
        self._kind = kind
        self.start()

    def start(self) -> None:
        """Start the process, and return before it serves."""
        options = ["--hand", HAND, "--listen", LOCAL, "--worker-threads", "--json"]
        command = [
            sys.executable,
            "-m",
            "graspforce",
            "serve",
            *options,
            "--connect",
            f"{self._kind}/127.0.0.1:{self.link.port}",
        ]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    def wait_until_ready(self) -> None:
        """Wait until the process serves."""
        assert self.process.stdout is not None
        self.address = json.loads(self.process.stdout.readline())["addresses"][0]
        self.process.stdout.close()

    def has_stream(self) -> bool:
        """Return whether the server has an open stream with commands."""
        return self.count_commands() > 0

    def count_commands(self) -> int:
        """Return the number of commands of the server's open streams."""
        with Client(self.address, timeout=TIMEOUT) as client:
            return sum(each.outcomes.get("ok", 0) for each in client.status().active_streams)

    def end(self) -> None:
        """Kill the process, and close the link."""
        self.process.kill()
        self.process.wait()
        self.link.__exit__()


class Cell:
    """A router, two replicas and a driver.

    Args:
        stack: closes all at the end.
        kinds: kinds of the links over which the servers join the router.
    """

    def __init__(self, stack: contextlib.ExitStack, kinds: tuple[str, str]) -> None:
        settings: dict[str, object] = {"listen/endpoints": [LOCAL, DATAGRAMS], "adminspace/enabled": True}
        config = build_configuration(ROUTER, {}, settings)
        session = stack.enter_context(zenoh.open(config))
        addresses = {each.partition("/")[0]: each for each in find_addresses(session, config)}
        self.router = addresses["tcp"]
        self.run = Run()
        self.replicas = [Replica(int(addresses[kind].rpartition(":")[2]), kind) for kind in kinds]
        for each in self.replicas:
            stack.callback(each.end)
        for each in self.replicas:
            each.wait_until_ready()
        command = Callback(self._count, indirect=False)
        session.declare_subscriber(f"{protocol.PREFIX}/streams/*/command", command)
        self._client = stack.enter_context(Client(self.router, timeout=2.0))
        deadline = time.monotonic() + TIMEOUT
        while len(self._client.servers()) < 2 and time.monotonic() < deadline:
            time.sleep(0.05)
        self._grasp = grasp = ball_grasp()
        stream = self._client.open_stream(grasp, ControlSettings(period=PERIOD), validity=0.1, watchdog=WATCHDOG)
        self.stream: Stream = stack.enter_context(stream)
        self.drive(0.4)

    def _count(self, sample: zenoh.Sample) -> None:
        record = protocol.decode(sample.payload.to_bytes(), protocol.select_codec(str(sample.encoding)))
        assert isinstance(record, dict)
        if "torque" in record:
            self.run.commands[record["sequence"]] += 1

    def drive(self, seconds: float, is_done: Callable[[Period], bool] | None = None) -> None:
        """Step the stream for a time, or at most until a period is the last."""
        start = tick = time.monotonic()
        while time.monotonic() - start < seconds:
            phase = 2.0 * np.pi * (time.monotonic() % 1.0)
            motion = BodyMotion(self._grasp.p_HO + 1e-3 * np.sin(phase) * np.eye(3)[2], self._grasp.R_HO)
            state = GraspState(self._grasp.q, np.zeros(self._grasp.hand.n), BodyMotion(self._grasp.p_HO, self._grasp.R_HO))
            command = self.stream.step(state, motion)
            period = Period(time.monotonic(), command.late, command.resuming, command.tau)
            self.run.periods.append(period)
            if is_done is not None and is_done(period):
                return
            tick = max(tick + PERIOD, time.monotonic())
            time.sleep(max(tick - time.monotonic(), 0.0))

    def find_owner(self) -> tuple[Replica, Replica]:
        """Return the replica that answers the stream, and the other one. The driver steps the stream in the meantime."""
        first, second = self.replicas
        deadline = time.monotonic() + TIMEOUT
        while time.monotonic() < deadline:
            before = [each.count_commands() for each in self.replicas]
            self.drive(_OWNER_TIME)
            has_grown = [each.count_commands() > count for each, count in zip(self.replicas, before, strict=True)]
            if has_grown == [True, False]:
                return first, second
            if has_grown == [False, True]:
                return second, first
        raise RuntimeError(f"neither or both of the replicas answer the stream after {TIMEOUT:g} s")

    def recover(self) -> None:
        """Step until the stream has been lost, and its torque has reached new commands."""
        self.drive(TIMEOUT, lambda each: each.late)
        self.drive(TIMEOUT, lambda each: not each.late and not each.resuming)

    def restart(self, replica: Replica) -> None:
        """Start the server of a replica again, and step the stream in the meantime."""
        replica.start()
        is_ready = threading.Thread(target=replica.wait_until_ready)
        is_ready.start()
        while is_ready.is_alive():
            self.drive(0.1)
        self.drive(SETTLE)


@dataclass(frozen=True, slots=True)
class Outcome:
    """Times and counts after a fault; see the page.

    Args:
        fault: its name.
        notice: s.
        move: s.
        reach: s.
        commands: largest number of commands of a state.
        step: largest torque step, N·m.
        late: share of the periods since the fault with the watchdog's torque.
    """

    fault: str
    notice: float
    move: float
    reach: float
    commands: int
    step: float
    late: float

    @classmethod
    def of(cls, fault: str, run: Run, start: float) -> Outcome:
        """Return the outcome of a run whose fault was at a time."""
        notice = run.since(start, lambda each: each.late)
        counts = (
            max(run.commands.values()),
            run.largest_step,
            float(np.mean([each.late for each in run.periods if each.time > start])),
        )
        if math.isnan(notice):  # the stream has moved without an interruption
            return cls(fault, math.nan, math.nan, math.nan, *counts)
        move = run.since(start + notice, lambda each: not each.late) + notice
        reach = run.since(start + notice, lambda each: not each.late and not each.resuming) + notice
        return cls(fault, notice, move, reach, *counts)


@contextlib.contextmanager
def start_cell(kinds: tuple[str, str] = ("tcp", "tcp")) -> Iterator[Cell]:
    """Start a router, two replicas and a driver.

    Args:
        kinds: kinds of the links over which the servers join the router.
    """
    with contextlib.ExitStack() as stack:
        yield Cell(stack, kinds)


def ball_grasp() -> Grasp:
    """Return the grasp of a ball by four fingers."""
    return find_grasp(Hand.load(HAND), Body.solid(Sphere(0.03), mass=0.05), friction=0.7)


def kill(cell: Cell, owner: Replica) -> float:
    """Kill the server of the stream."""
    start = time.monotonic()
    owner.process.kill()
    cell.recover()
    owner.process.wait()
    return start


def freeze(cell: Cell, owner: Replica) -> float:
    """Freeze the server of the stream, and thaw it after the stream has moved."""
    owner.process.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, owner.process.pid, os.WSTOPPED | os.WNOWAIT)
    start = time.monotonic()
    cell.recover()
    owner.process.send_signal(signal.SIGCONT)
    cell.drive(SETTLE)
    return start


def drain(cell: Cell, owner: Replica) -> float:
    """Drain the server of the stream."""
    start = time.monotonic()
    owner.process.terminate()
    cell.drive(SETTLE)
    owner.process.wait()
    return start


def cut(cell: Cell, owner: Replica) -> float:
    """Cut the link of the server of the stream, and heal it after the stream has moved."""
    start = time.monotonic()
    owner.link.is_cut = True
    cell.recover()
    owner.link.is_cut = False
    cell.drive(SETTLE)
    return start


def slow(cell: Cell, owner: Replica) -> float:
    """Slow the link of the server of the stream for a time: its commands are later than their validity."""
    start = time.monotonic()
    owner.link.delay = 0.06
    cell.drive(SETTLE)
    owner.link.delay = 0.0
    cell.drive(TIMEOUT, lambda each: not each.late and not each.resuming)
    return start


def lose(cell: Cell, owner: Replica, seconds: float = SETTLE) -> float:
    """Make the link of the server of the stream lossy for a time, s."""
    start = time.monotonic()
    owner.link.loss, owner.link.delay, owner.link.jitter = LOSS, LOSSY_DELAY, LOSSY_JITTER
    cell.drive(seconds)
    owner.link.loss = owner.link.delay = owner.link.jitter = 0.0
    cell.drive(TIMEOUT, lambda each: not each.late and not each.resuming)
    return start


FAULTS: dict[str, Callable[[Cell, Replica], float]] = {
    "killed": kill,
    "frozen and thawed": freeze,
    "drained by SIGTERM": drain,
    "link cut and healed": cut,
    f"link slowed by 60 ms each way for {SETTLE:g} s": slow,
    f"TCP link with 10 % loss and jitter for {SETTLE:g} s": lose,
}
DATAGRAM_FAULTS: dict[str, Callable[[Cell, Replica], float]] = {
    f"UDP link with 10 % loss and jitter for {SETTLE:g} s": lose,
    "UDP link cut and healed": cut,
}


def measure() -> list[Outcome]:
    """Return the outcomes of all faults, in a cell with TCP links and one with UDP links."""
    return [*_measure("tcp", FAULTS), *_measure("udp", DATAGRAM_FAULTS)]


def _measure(kind: str, faults: dict[str, Callable[[Cell, Replica], float]]) -> list[Outcome]:
    """Return the outcomes of faults in one cell."""
    outcomes = []
    with start_cell((kind, kind)) as cell:
        for name, fault in faults.items():
            owner, _ = cell.find_owner()
            cell.run.periods.clear()
            cell.run.commands.clear()
            cell.drive(0.4)
            start = fault(cell, owner)
            if owner.process.poll() is not None:
                cell.restart(owner)
            outcomes.append(Outcome.of(name, cell.run, start))
    return outcomes


def _time(seconds: float) -> str:
    """Return the text of a time; a dash for none."""
    return "–" if math.isnan(seconds) else f"{seconds:.3f}"


def _show(outcomes: list[Outcome], save: Path | None) -> None:
    """Print the table and write the page."""
    head = (
        "fault of the stream's server",
        "to notice s",
        "to move s",
        "to reach s",
        "commands a state",
        "torque step / bound",
        "late periods",
    )
    rows = [
        (
            o.fault,
            *map(_time, (o.notice, o.move, o.reach)),
            f"{o.commands}",
            f"{o.step / WATCHDOG.step:.3f}",
            f"{100.0 * o.late:.1f} %",
        )
        for o in outcomes
    ]
    report_page.publish("Faults of replicas behind a router", __doc__, head, rows, save, width=150)


def main() -> None:
    """Measure, print the table and write the page."""
    options = report_page.parser("replicas", __doc__).parse_args()
    _show(measure(), options.save)


if __name__ == "__main__":
    main()
