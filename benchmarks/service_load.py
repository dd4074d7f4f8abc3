"""Processes of the benchmarks of the service: servers, echoes, and clients that send requests of one kind."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from scipy.spatial.transform import Rotation
from zenoh.handlers import Callback, RingChannel

from benchmarks.control_stream import allegro_grasp
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.planning import FreeMove
from graspforce.planning.tracking import object_task
from graspforce.service import Client, use_realtime_scheduling
from graspforce.service.realtime_scheduling import end_realtime_scheduling
from graspforce.service.wire import protocol
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.reply import make_error_reply
from graspforce.service.zenoh_session import build_configuration, find_addresses

HAND = "allegro_right"
LOCAL = "tcp/127.0.0.1:0"
TIMEOUT = 15.0  # s
STATE_BYTES, COMMAND_BYTES = 741, 1659  # of the messages of a stream of `allegro_grasp`, for the echo
KINDS = ("control", "solve", "status", "mixed", "distribute", "open and close", "streams", "4 MB", "8 MB", "100 MB", "plans")
_SETTLE = 0.5  # s, after an echo or a client has connected

Request = tuple[str, bytes]  # key after the prefix, and payload


@dataclass(frozen=True, slots=True)
class Load:
    """Requests of one kind.

    Args:
        kind: one of `KINDS`.
        rate: turns per second; None for as many as `outstanding` allows.
        outstanding: largest number of requests without an answer.
        names: number of names that the client gives itself.
        budget: of each request, s.
    """

    kind: str
    rate: float | None = None
    outstanding: int = 200
    names: int = 1
    budget: float = 3.0


@dataclass(frozen=True, slots=True)
class LoadResult:
    """Answers to the requests of a load.

    Args:
        seconds: by outcome, the times from request to answer, s. Outcomes are "ok", error codes, "late" for Zenoh's own time
            limit, and "no reply".
    """

    seconds: dict[str, list[float]] = field(default_factory=dict)

    def add(self, other: LoadResult) -> None:
        """Add the answers of another burst."""
        for outcome, seconds in other.seconds.items():
            self.seconds.setdefault(outcome, []).extend(seconds)

    def count(self, outcome: str | None = None) -> int:
        """Return the number of answers with an outcome, or of all."""
        return sum(len(seconds) for each, seconds in self.seconds.items() if outcome in (None, each))

    def quantile(self, fraction: float, outcome: str) -> float:
        """Return a quantile of the times of an outcome, s; NaN without answers."""
        seconds = self.seconds.get(outcome, [])
        return float(np.quantile(seconds, fraction)) if seconds else float("nan")

    def __str__(self) -> str:
        return ", ".join(f"{len(seconds)} {outcome}" for outcome, seconds in sorted(self.seconds.items())) or "–"


# ── requests ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


def large_problem(grasp: Grasp, count: int) -> dict[str, object]:
    """Return the request to distribute the weight of an object over many contacts near those of a grasp."""
    rng, n = np.random.default_rng(1), len(grasp.fingers)
    points = grasp.contacts.p_OC[np.arange(count) % n] + 0.004 * rng.standard_normal((count, 3))  # m
    points *= 0.03 / np.linalg.norm(points, axis=1)[:, None]  # on the ball
    contacts = [
        {"position": p.tolist(), "normal": (-p / 0.03).tolist(), "friction": 0.7, "finger": grasp.fingers[i % n]}
        for i, p in enumerate(points)
    ]
    return {"posture": grasp.q.tolist(), "object": _pose(grasp), "contacts": contacts, "wrench": [0, 0, 0.5, 0, 0, 0]}


def _pose(grasp: Grasp) -> dict[str, object]:
    return {"position": grasp.p_HO.tolist(), "rotation": grasp.R_HO.tolist()}


def _control_request(grasp: Grasp) -> dict[str, object]:
    hold = StreamSetup(grasp, ControlSettings()).to_dict()["hold"]
    return {"hold": hold, "state": {"posture": grasp.q.tolist(), "object": _pose(grasp)}, "desired": _pose(grasp)}


def _free_move(grasp: Grasp) -> dict[str, object]:
    p_HO = grasp.p_HO + np.array([[0.0, 0.0, 0.0], [0.002, 0.0, 0.003]])
    goal = Rotation.from_rotvec([0.05, 0.0, 0.0]).as_matrix() @ grasp.R_HO
    return FreeMove(object_task(grasp, ControlSettings()), p_HO, np.array([grasp.R_HO, goal]), q_start=grasp.q).to_dict()


def make_requests(kind: str, budget: float) -> Callable[[int], list[Request]]:
    """Return a function that returns the requests of a turn.

    Args:
        kind: one of `KINDS`.
        budget: of each request, s.
    """
    grasp = allegro_grasp()

    def encode(record: Any) -> bytes:
        return protocol.encode({**record, "budget": budget}, protocol.MSGPACK)

    setup, close = encode(StreamSetup(grasp, ControlSettings()).to_dict()), encode({"close": True})
    pinch = [{"position": [0, s * 0.03, 0], "normal": [0, -s, 0], "friction": 0.5, "max_normal": 20.0} for s in (1, -1)]
    makers: dict[str, Callable[[], tuple[str, Any]]] = {
        "control": lambda: (f"hands/{HAND}/control", _control_request(grasp)),
        "solve": lambda: ("solve", {"schema": "graspforce/problem/1", "wrench": [0, 0, 1.0, 0, 0, 0], "contacts": pinch}),
        "status": lambda: ("status", {}),
        "distribute": lambda: (f"hands/{HAND}/distribute", large_problem(grasp, 400)),
        "plans": lambda: (f"hands/{HAND}/plan", _free_move(grasp)),
        "4 MB": lambda: ("solve", {"x": "y" * 4_000_000}),
        "8 MB": lambda: ("solve", {"x": "y" * 8_000_000}),
        "100 MB": lambda: ("solve", {"x": "y" * 100_000_000}),
    }
    if kind == "streams":
        return lambda turn: [(f"streams/flood-{turn}", setup)]
    if kind == "mixed":
        mixed = [(key, encode(record)) for key, record in (makers[each]() for each in ("control", "solve", "status"))]
        return lambda turn: [mixed[turn % len(mixed)]]
    if kind == "open and close":
        return lambda turn: [("streams/load", setup if turn % 2 == 0 else close)]
    key, record = makers[kind]()
    payload = encode(record)
    return lambda turn: [(key, payload)]


class _Sender:
    """A thread that sends the requests of a load until it is stopped."""

    def __init__(self, session: zenoh.Session, load: Load) -> None:
        self._session, self._load, self._requests = session, load, make_requests(load.kind, load.budget)
        self._result, self._lock = LoadResult(), threading.Lock()
        self._stopped, self._free = threading.Event(), threading.Semaphore(load.outstanding)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def stop(self) -> LoadResult:
        """Stop, and return the answers after the last one has arrived."""
        self._stopped.set()
        self._thread.join()
        deadline = time.monotonic() + TIMEOUT
        for _ in range(self._load.outstanding):
            self._free.acquire(timeout=max(deadline - time.monotonic(), 0.0))
        return self._result

    def _run(self) -> None:
        start, turn = time.perf_counter(), 0
        while not self._stopped.is_set():
            for key, payload in self._requests(turn):
                self._send(key, payload, f"{self._session.zid()}/{turn % self._load.names}")
            turn += 1
            if self._load.rate is not None:
                self._stopped.wait(max(start + turn / self._load.rate - time.perf_counter(), 0.0))

    def _send(self, key: str, payload: bytes, client: str) -> None:
        self._free.acquire()
        outcomes: list[str] = []
        start = time.perf_counter()

        def receive(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                outcomes.append("ok")
            elif str(reply.err.encoding) == protocol.MSGPACK:
                outcomes.append(protocol.decode(reply.err.payload.to_bytes(), protocol.MSGPACK)["error"])  # type: ignore[index]
            else:
                outcomes.append("late")  # Zenoh's own error record

        def done() -> None:
            with self._lock:
                outcome = outcomes[0] if outcomes else "no reply"
                self._result.seconds.setdefault(outcome, []).append(time.perf_counter() - start)
            self._free.release()

        self._session.get(
            f"{protocol.PREFIX}/{key}",
            Callback(receive, done, indirect=False),  # no thread for each request: they would slow the flood down
            payload=payload,
            encoding=protocol.MSGPACK,
            attachment=client.encode(),
            timeout=TIMEOUT,
        )


# ── processes ──────────────────────────────────────────────────────────────────────────────────────────────────────────────


def may_use_realtime_scheduling() -> bool:
    """Return whether the system permits real-time scheduling."""
    try:
        use_realtime_scheduling()
    except InvalidInput:
        return False
    end_realtime_scheduling()
    return True


@contextlib.contextmanager
def python_process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run a Python module in a process with pipes, and end it afterwards."""
    with subprocess.Popen(
        [sys.executable, "-m", *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        try:
            yield child
        finally:
            child.terminate()


def read_line(child: subprocess.Popen[str]) -> str:
    """Return the next line of a process."""
    assert child.stdout is not None
    return child.stdout.readline().strip()


def send_line(child: subprocess.Popen[str], line: str) -> None:
    """Send a line to a process."""
    assert child.stdin is not None
    child.stdin.write(line + "\n")
    child.stdin.flush()


@dataclass(frozen=True, slots=True)
class ServerUnderTest:
    """A running ``graspforce serve``.

    Args:
        address: its endpoint.
        pid: its process.
    """

    address: str
    pid: int

    def memory(self) -> float:
        """Return the resident memory of the server's process and its children, MiB."""
        pages = sum(_resident_pages(pid) for pid in (self.pid, *_children(self.pid)))
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    def own_memory(self) -> float:
        """Return the resident memory of the server's process, MiB."""
        return _resident_pages(self.pid) * os.sysconf("SC_PAGE_SIZE") / 2**20

    def files(self) -> int:
        """Return the number of open files of the server's process and its children."""
        return self._count("fd")

    def threads(self) -> int:
        """Return the number of threads of the server's process and its children."""
        return self._count("task")

    def _count(self, name: str) -> int:
        """Return the number of entries of a folder of all processes."""
        count = 0
        for pid in (self.pid, *_children(self.pid)):
            with contextlib.suppress(OSError):
                count += len(os.listdir(f"/proc/{pid}/{name}"))
        return count


def _resident_pages(pid: int) -> int:
    """Return the resident pages of a process; 0 if it has ended."""
    with contextlib.suppress(OSError):
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return 0


def _children(pid: int) -> list[int]:
    """Return the child processes of a process."""
    children = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):
            children += map(int, (task / "children").read_text().split())
    return children


@contextlib.contextmanager
def start_server(*options: str) -> Iterator[ServerUnderTest]:
    """Run ``graspforce serve`` with options, and wait until it answers requests of all classes."""
    with python_process("graspforce", "serve", "--hand", HAND, "--listen", LOCAL, "--json", *options) as child:
        server = ServerUnderTest(json.loads(read_line(child))["addresses"][0], child.pid)
        with start_client(server.address) as client:
            for load in (Load("control", outstanding=4), Load("distribute", outstanding=1)):
                client.start(load)
                time.sleep(_SETTLE)
                client.stop()  # waits for the answers, and therefore for the worker processes
        yield server


class LoadClient:
    """A process that sends requests.

    Args:
        child: the process.
    """

    def __init__(self, child: subprocess.Popen[str]) -> None:
        self._child = child

    def start(self, load: Load) -> None:
        """Begin to send requests."""
        send_line(self._child, json.dumps(asdict(load)))
        assert read_line(self._child) == "started"

    def stop(self) -> LoadResult:
        """Stop, and return the answers after the last one has arrived."""
        send_line(self._child, "")
        return LoadResult(json.loads(read_line(self._child)))


@contextlib.contextmanager
def start_client(address: str) -> Iterator[LoadClient]:
    """Start a process that sends requests to a server."""
    with python_process("benchmarks.service_load", "load", address) as child:
        assert read_line(child) == "ready"
        yield LoadClient(child)


def _run_client(address: str) -> None:
    """Send the load that each line of standard input describes; an empty line stops it and prints the answers."""
    sys.setswitchinterval(1e-4)  # the thread that sends holds up the one that receives for at most this time, s
    with zenoh.open(build_configuration(None, {"mode": "client"}, {"connect/endpoints": [address]})) as session:
        print("ready", flush=True)
        sender: _Sender | None = None
        for line in sys.stdin:
            if line.strip():
                sender = _Sender(session, Load(**json.loads(line)))
                print("started", flush=True)
            elif sender is not None:
                print(json.dumps(sender.stop().seconds), flush=True)


class Echo:
    """Round trips to an echo process.

    Args:
        address: endpoint of the echo, or of the server that relays its messages.
    """

    def __init__(self, address: str) -> None:
        self._session = zenoh.open(build_configuration(None, {"mode": "client"}, {"connect/endpoints": [address]}))
        self._state = self._session.declare_publisher("echo/state", congestion_control=zenoh.CongestionControl.DROP)
        self._command = self._session.declare_subscriber("echo/command", RingChannel(1))
        time.sleep(_SETTLE)

    def step(self) -> None:
        """Make one round trip."""
        self._state.put(b"x" * STATE_BYTES)
        self._command.handler.recv()

    def close(self) -> None:
        """Close the session."""
        self._session.close()


@contextlib.contextmanager
def start_echo(server: str = "", realtime: int = 0) -> Iterator[Echo]:
    """Start an echo process, which replies from another thread behind a ring buffer of one message.

    Args:
        server: endpoint of a server that relays the messages; empty for a direct connection.
        realtime: its real-time priority; 0 for ordinary scheduling.
    """
    with python_process("benchmarks.service_load", "echo", server, str(realtime)) as child:
        echo = Echo(read_line(child))
        try:
            yield echo
        finally:
            echo.close()


def _run_echo(server: str, realtime: str) -> None:
    """Answer each message with one of a command's size until standard input closes."""
    if realtime != "0":
        use_realtime_scheduling(int(realtime))
    sys.setswitchinterval(1e-4)  # as `graspforce serve` does
    settings = {"connect/endpoints": [server]} if server else {"listen/endpoints": [LOCAL], "adminspace/enabled": True}
    configuration = build_configuration(None, {"mode": "client" if server else "peer"}, settings)
    with zenoh.open(configuration) as session:
        command = session.declare_publisher("echo/command", congestion_control=zenoh.CongestionControl.DROP)
        states = session.declare_subscriber("echo/state", RingChannel(1))

        def run() -> None:
            with contextlib.suppress(zenoh.ZError):
                while True:
                    states.handler.recv()
                    command.put(b"x" * COMMAND_BYTES)

        thread = threading.Thread(target=run)
        thread.start()
        print(server or find_addresses(session, configuration)[0], flush=True)
        sys.stdin.read()
        states.undeclare()
        thread.join()


@contextlib.contextmanager
def start_bare_refusals() -> Iterator[str]:
    """Start a Zenoh queryable that refuses every request at once, without a service, and return its endpoint."""
    with python_process("benchmarks.service_load", "refuse") as child:
        yield read_line(child)


def _run_refusals() -> None:
    """Refuse all requests until standard input closes."""
    sys.setswitchinterval(1e-4)  # as `graspforce serve` does
    refusal = make_error_reply(protocol.MSGPACK, "overloaded", "this server refuses every request", None, None, 0.1)

    def refuse(query: zenoh.Query) -> None:
        query.reply_err(refusal.payload, encoding=protocol.MSGPACK)

    settings = {"listen/endpoints": [LOCAL], "adminspace/enabled": True}
    configuration = build_configuration(None, {"mode": "peer"}, settings)
    with zenoh.open(configuration) as session:
        queryable = session.declare_queryable(f"{protocol.PREFIX}/**", refuse)
        print(find_addresses(session, configuration)[0], flush=True)
        sys.stdin.read()
        queryable.undeclare()


def _run_streams(address: str, count: int, period: float) -> None:
    """Step several streams in turn, each once a period, until standard input closes."""
    grasp, settings, is_open = allegro_grasp(), ControlSettings(period=period), True
    state = GraspState(grasp.q, np.zeros(grasp.hand.n), BodyMotion(grasp.p_HO, grasp.R_HO))
    with Client(address, timeout=TIMEOUT) as client, contextlib.ExitStack() as stack:
        streams = [stack.enter_context(client.open_stream(grasp, settings)) for _ in range(count)]
        print("ready", flush=True)

        def wait() -> None:
            nonlocal is_open
            sys.stdin.read()
            is_open = False

        threading.Thread(target=wait, daemon=True).start()
        tick = time.perf_counter()
        for stream in itertools.cycle(streams):
            if not is_open:
                break
            stream.step(state, state.object, wait=0.0)  # drivers that wait would need a processor
            tick = max(tick + period / count, time.perf_counter())
            time.sleep(max(tick - time.perf_counter(), 0.0))


@contextlib.contextmanager
def start_streams(address: str, count: int, period: float) -> Iterator[None]:
    """Step several streams from another process.

    Args:
        address: endpoint of the server.
        count: number of streams.
        period: of each stream, s.
    """
    with python_process("benchmarks.service_load", "streams", address, str(count), str(period)) as child:
        assert read_line(child) == "ready"
        yield


if __name__ == "__main__":
    role, *arguments = sys.argv[1:]
    if role == "streams":
        _run_streams(arguments[0], int(arguments[1]), float(arguments[2]))
    else:
        {"load": _run_client, "echo": _run_echo, "refuse": _run_refusals}[role](*arguments)
