"""Overhead of a control stream over Zenoh: `python -m benchmarks.control_stream`.

The driver (this process) and the server (another process) communicate over loopback TCP. Four subjects take turns in bursts,
so that a drift of the machine's speed affects them equally:

- an echo: messages of the sizes of a state and a command, by Zenoh alone. The far end replies in Zenoh's receiving thread,
  which a service must not block;
- the same echo with a reply from another thread, behind a ring buffer of one message, as in the service;
- the control step alone: `ObjectController.step` in this process, on the same states;
- the stream: `Stream.step`. The command states the time of its part in the server, from the receipt of the state.

All subjects run at 1 kHz. The ratio is the time of the stream without its part in the server over that of the echo.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from datetime import date
from typing import Any

import numpy as np
import zenoh
from scipy.spatial.transform import Rotation
from zenoh.handlers import Callback, RingChannel

import graspforce
from benchmarks import report_page
from graspforce import Contact, ContactSet, Hand
from graspforce.bench.conditions import processor
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlMemory, ControlSettings, GraspState, ObjectController
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.service import Client, Server, StreamState
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.zenoh_session import build_configuration

FINGERS = ("index", "middle", "thumb")
BURST = 50  # consecutive round trips of a subject
WARM_UP = 10  # round trips of a burst that are not timed
PERIOD = 1e-3  # s, between round trips; without pauses Zenoh's threads do not sleep, and an echo takes half the time
IN_SERVER, OUTSIDE = "stream, part in the server", "stream without its part in the server"  # subjects
LOCAL = "tcp/127.0.0.1:0"
TIMEOUT = 5.0  # s


def allegro_grasp() -> Grasp:
    """Return the grasp of a sphere of 50 g and 60 mm diameter by three fingers of the right Allegro hand."""
    hand, ball, p_HO = Hand.load("allegro_right"), Sphere(0.03), np.array([0.0983, 0.0384, 0.0283])
    tips = np.array([hand.tip_pose(hand.neutral, finger)[0] for finger in FINGERS])
    closest_points = ball.project_to_surface(tips - p_HO)
    contacts = [
        Contact(p, n, friction=0.7, max_normal=20.0)
        for p, n in zip(closest_points, ball.inward_normal(closest_points), strict=True)
    ]
    stacked = ContactSet.stack(contacts)
    q = hand.grasp_posture(FINGERS, stacked, p_HO, np.eye(3))
    return Grasp(hand, Body.solid(ball, 0.05), FINGERS, stacked, q, p_HO, np.eye(3))


def state_sequence(grasp: Grasp, count: int) -> list[tuple[GraspState, BodyMotion]]:
    """Return measured states at rest with sensor noise, and the accelerations of a sinusoid of 10 mm at 1 Hz."""
    rng, sequence = np.random.default_rng(1), []
    for phase in np.linspace(0.0, 2.0 * np.pi, count):
        turn = Rotation.from_rotvec(1e-4 * rng.standard_normal(3)).as_matrix()
        measured = BodyMotion(grasp.p_HO + 1e-5 * rng.standard_normal(3), turn, 1e-4 * rng.standard_normal(6))
        q = grasp.q + 1e-4 * rng.standard_normal(grasp.hand.n)
        a = np.array([0.0, 0.0, -5e-3 * (2.0 * np.pi) ** 2 * np.sin(phase), 0.0, 0.0, 0.0])  # m/s²
        state = GraspState(q, 1e-3 * rng.standard_normal(grasp.hand.n), measured)
        sequence.append((state, BodyMotion(grasp.p_HO, grasp.R_HO, acceleration=a)))
    return sequence


def serve_remote_end() -> None:
    """Run the service and both echoes in the other process, until its standard input closes."""
    sys.setswitchinterval(1e-4)  # as `graspforce serve` does
    if "--pin" in sys.argv:
        os.sched_setaffinity(0, {1})
    reply = b"x" * int(sys.argv[2])
    with Server(["allegro_right"], listen=LOCAL) as server, zenoh.open(_settings("peer", "listen", LOCAL)) as session:
        direct, ringed = (session.declare_publisher(f"echo/{kind}/command") for kind in ("direct", "ring"))
        session.declare_subscriber("echo/direct/state", Callback(lambda _: direct.put(reply), indirect=False))
        states = session.declare_subscriber("echo/ring/state", RingChannel(1))

        def run() -> None:
            receive = states.handler.recv
            with contextlib.suppress(zenoh.ZError):
                while True:
                    receive()
                    ringed.put(reply)

        thread = threading.Thread(target=run)
        thread.start()
        print(server.addresses[0], _listening(session), flush=True)
        sys.stdin.read()
        states.undeclare()
        thread.join()


def _settings(mode: str, side: str, address: str) -> zenoh.Config:
    return build_configuration(None, {"mode": mode, "adminspace/enabled": True}, {f"{side}/endpoints": [address]})


def _listening(session: zenoh.Session) -> str:
    [reply] = session.get(f"@/{session.zid()}/*", timeout=TIMEOUT)
    return str(json.loads(reply.ok.payload.to_bytes())["locators"][0])


@contextlib.contextmanager
def remote_end(size: int, pin: bool) -> Iterator[tuple[str, str]]:
    """Start the far end in its own process, and yield the addresses of the service and of the echoes.

    Args:
        size: size of an echo's reply, bytes.
        pin: whether the process is pinned to processor 1.
    """
    command = [sys.executable, "-m", "benchmarks.control_stream", "--far-end", str(size), *(["--pin"] if pin else [])]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        service, echo = child.stdout.readline().split()
        yield service, echo
        child.communicate()


def echo(session: zenoh.Session, kind: str, payload: bytes) -> Callable[[int], Any]:
    """Return a function that makes one round trip of an echo."""
    publisher = session.declare_publisher(f"echo/{kind}/state")
    handler = session.declare_subscriber(f"echo/{kind}/command", RingChannel(1))

    def run(i: int) -> Any:
        publisher.put(payload)
        return handler.recv()

    return run


def measure(rounds: int, pin: bool = False) -> tuple[dict[str, np.ndarray], int, int]:
    """Return the times of all round trips by subject, s, and the sizes of a state and a command, bytes.

    Args:
        rounds: number of bursts of each subject.
        pin: whether driver and server are pinned to different processors.
    """
    grasp = allegro_grasp()
    points, controller = state_sequence(grasp, BURST), ObjectController(grasp)
    state, desired = points[0]
    command = controller.step(state, desired)
    memory: ControlMemory = controller.memory
    record = CommandRecord.pack(command, memory, binary=True)
    record.sequence, record.time, record.server_seconds = 10**6, time.monotonic(), 1e-4
    out = StreamState(10**6, time.monotonic(), state, desired).encode(protocol.MSGPACK)
    back = protocol.encode(record, protocol.MSGPACK)
    times: dict[str, list[float]] = {}
    if pin:
        os.sched_setaffinity(0, {0})
    with (
        remote_end(len(back), pin) as (service, echoes),
        Client(service, timeout=TIMEOUT) as client,
        zenoh.open(_settings("client", "connect", echoes)) as session,
        client.open_stream(grasp, ControlSettings(), validity=TIMEOUT) as stream,
    ):
        subjects: dict[str, Callable[[int], Any]] = {
            "echo": echo(session, "direct", out),
            "echo behind a ring buffer": echo(session, "ring", out),
            "control step": lambda i: controller.step(*points[i]),
            "stream": lambda i: stream.step(*points[i], wait=TIMEOUT),
        }
        time.sleep(0.5)  # s, for discovery of both ends
        stream.step(*points[0], wait=TIMEOUT)
        for _ in range(rounds):
            for name, run in subjects.items():
                own = times.setdefault(name, [])
                tick = time.perf_counter()
                for i in range(BURST):
                    tick = max(tick + PERIOD, time.perf_counter())
                    time.sleep(max(tick - time.perf_counter(), 0.0))
                    start = time.perf_counter()
                    reply = run(i)
                    elapsed = time.perf_counter() - start
                    if i >= WARM_UP:
                        own.append(elapsed)
                        if name == "stream":
                            assert reply.sequence == stream.sequence  # this state's command
                            assert not reply.forces_reused
                            assert not reply.late
                            times.setdefault(IN_SERVER, []).append(reply.server_seconds)
                            times.setdefault(OUTSIDE, []).append(elapsed - reply.server_seconds)
    return {name: np.array(own) for name, own in times.items()}, len(out), len(back)


def report(times: dict[str, np.ndarray], out: int, back: int) -> str:
    """Return the times as a Markdown page, with machine, versions and command."""
    lines = [
        "# Overhead of a control stream over Zenoh",
        "",
        f"graspforce {graspforce.__version__}, {date.today()}. Driver and server are two processes on loopback TCP. The right",
        f"Allegro hand holds a sphere with three fingers. A state has {out} bytes, a command {back}. {processor()},",
        f"{os.cpu_count()} cores, Python {platform.python_version()}. The machine is shared; use the ratios.",
        f"Load average: {os.getloadavg()[0]:.1f}. Command: `{report_page.command()}`.",
        "",
        f"Subjects take turns in bursts of {BURST} round trips at 1 kHz; the first {WARM_UP} of a burst are not timed.",
        "",
        "- The echo is Zenoh alone with messages of the same sizes, and a reply in Zenoh's receiving thread. Behind a ring",
        "  buffer, another thread replies, as in the service.",
        "- The round trip of the stream is `Stream.step`, from arrays to arrays. Its part in the server lasts from the receipt",
        "  of the state until the command is ready for encoding.",
        "- The control step is `ObjectController.step` in the driver's process.",
        "",
        "| subject | 10 % µs | median µs | 90 % µs | 99 % µs | max µs |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for name, own in times.items():
        spread = 1e6 * np.array([*np.quantile(own, [0.1, 0.5, 0.9, 0.99]), own.max()])
        lines.append(f"| {name} | " + " | ".join(f"{value:.0f}" for value in spread) + " |")
    median = {name: float(np.median(own)) for name, own in times.items()}
    bursts = {name: np.median(own.reshape(-1, BURST - WARM_UP), axis=1) for name, own in times.items()}
    low, high = np.quantile(bursts[OUTSIDE] / bursts["echo"], [0.1, 0.9])
    lines += [
        "",
        f"Without its part in the server the stream takes **{median[OUTSIDE] / median['echo']:.2f} times the bare echo**, and"
        f" {median[OUTSIDE] / median['echo behind a ring buffer']:.2f} times",
        f"the echo behind a ring buffer. As a whole it takes {median['stream'] / median['echo']:.2f} times the bare echo."
        f" Medians over {len(times['stream'])} round trips each.",
        f"The first ratio varies between bursts from {low:.2f} to {high:.2f} (10 % to 90 %).",
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure, print the page and write it."""
    parser = report_page.parser("control_stream", __doc__)
    parser.add_argument("--rounds", type=int, default=50, help="bursts of each subject")
    parser.add_argument("--pin", action="store_true", help="pin the driver to processor 0 and the other process to processor 1")
    options = parser.parse_args()
    page = report(*measure(options.rounds, options.pin))
    print(page)
    if options.save:
        options.save.write_text(page)
        print(f"written to {options.save}")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--far-end"]:
        serve_remote_end()
    else:
        main()
