"""What a control stream adds to Zenoh: `python -m benchmarks.control_stream`.

Two processes on this machine over loopback TCP: a driver here, a server there. Five things take turns in bursts, so that a
machine whose speed drifts slows them alike:

- an echo: bytes of a state's size out, bytes of a command's size back, Zenoh and nothing else. Its far end answers in Zenoh's
  own receiving thread, as the service may not;
- the same echo answered from a thread behind a ring of one message, as the service must;
- the stream without its control step: `Stream.step`, from a state's arrays to a command's, with everything that the service
  does but the step itself, in whose place the server takes a command that it made before;
- the control step alone, `ObjectController.step` in this process, on the states that are streamed;
- the stream as it is.

All go at the pace of a controller, one a millisecond. The ratio is the stream without its control step over the echo.
"""

from __future__ import annotations

import argparse
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
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from scipy.spatial.transform import Rotation
from zenoh.handlers import Callback, RingChannel

import graspforce
from graspforce import Contact, ContactSet, Hand
from graspforce.bench.race import processor
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlMemory, ControlSettings, GraspState, ObjectController
from graspforce.control.object_controller import ObjectControlLaw
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.service import Client, Server, StreamState
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.zenoh_session import build_configuration

FINGERS = ("index", "middle", "thumb")
BURST = 50  # round trips that a subject makes at a time, the first ten to warm up
WARM_UP = 10
PERIOD = (
    1e-3  # s, from one round trip to the next: back to back, Zenoh's threads do not fall asleep and an echo takes half as long
)
SKIP_STEP_SETTINGS = ControlSettings(contact_tolerance=0.123)  # m: whose steps the far end skips
LOCAL = "tcp/127.0.0.1:0"
TIMEOUT = 5.0  # s


def allegro_grasp() -> Grasp:
    """Three fingers of the right Allegro hand about a ball of 50 g and 60 mm."""
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
    """Measured states of a hold with noise as of sensors, and the accelerations of a sinusoid of 10 mm at 1 Hz."""
    rng, made = np.random.default_rng(1), []
    for phase in np.linspace(0.0, 2.0 * np.pi, count):
        turn = Rotation.from_rotvec(1e-4 * rng.standard_normal(3)).as_matrix()
        seen = BodyMotion(grasp.p_HO + 1e-5 * rng.standard_normal(3), turn, 1e-4 * rng.standard_normal(6))
        q = grasp.q + 1e-4 * rng.standard_normal(grasp.hand.n)
        a = np.array([0.0, 0.0, -5e-3 * (2.0 * np.pi) ** 2 * np.sin(phase), 0.0, 0.0, 0.0])  # m/s²
        state = GraspState(q, 1e-3 * rng.standard_normal(grasp.hand.n), seen)
        made.append((state, BodyMotion(grasp.p_HO, grasp.R_HO, acceleration=a)))
    return made


def serve_remote_end() -> None:
    """Run the other process, service and both echoes, until its input ends."""
    sys.setswitchinterval(1e-4)  # as `graspforce serve` does
    if "--pin" in sys.argv:
        os.sched_setaffinity(0, {1})
    answer = b"x" * int(sys.argv[2])
    _skip_steps()
    with Server(["allegro_right"], listen=LOCAL) as server, zenoh.open(_settings("peer", "listen", LOCAL)) as session:
        direct, ringed = (session.declare_publisher(f"echo/{kind}/command") for kind in ("direct", "ring"))
        session.declare_subscriber("echo/direct/state", Callback(lambda _: direct.put(answer), indirect=False))
        states = session.declare_subscriber("echo/ring/state", RingChannel(1))

        def run() -> None:
            take = states.handler.recv
            with contextlib.suppress(zenoh.ZError):
                while True:
                    take()
                    ringed.put(answer)

        thread = threading.Thread(target=run)
        thread.start()
        print(server.addresses[0], _listening(session), flush=True)
        sys.stdin.read()
        states.undeclare()
        thread.join()


def _skip_steps() -> None:
    """In this process a stream whose settings are marked gets the command of its first state for every other."""
    step, first = ObjectControlLaw.step, {}

    def skipped(
        law: ObjectControlLaw, memory: ControlMemory, state: GraspState, desired: BodyMotion, external: Any = None
    ) -> Any:
        if law.settings.contact_tolerance != SKIP_STEP_SETTINGS.contact_tolerance:
            return step(law, memory, state, desired, external)
        if law not in first:
            first[law] = step(law, memory, state, desired, external)
        return first[law]

    ObjectControlLaw.step = skipped  # type: ignore[method-assign]


def _settings(mode: str, side: str, address: str) -> zenoh.Config:
    return build_configuration(None, {"mode": mode, "adminspace/enabled": True}, {f"{side}/endpoints": [address]})


def _listening(session: zenoh.Session) -> str:
    [reply] = session.get(f"@/{session.zid()}/*", timeout=TIMEOUT)
    return str(json.loads(reply.ok.payload.to_bytes())["locators"][0])


@contextlib.contextmanager
def remote_end(answer: int, pin: bool) -> Iterator[tuple[str, str]]:
    """Start the far end in its own process; yield the addresses of the service and the echoes."""
    command = [sys.executable, "-m", "benchmarks.control_stream", "--far-end", str(answer), *(["--pin"] if pin else [])]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        service, echo = child.stdout.readline().split()
        yield service, echo
        child.communicate()


def echo(session: zenoh.Session, kind: str, payload: bytes) -> Callable[[int], Any]:
    """One round trip of an echo."""
    publisher = session.declare_publisher(f"echo/{kind}/state")
    handler = session.declare_subscriber(f"echo/{kind}/command", RingChannel(1))

    def run(i: int) -> Any:
        publisher.put(payload)
        return handler.recv()

    return run


def measure(rounds: int, pin: bool = False) -> tuple[dict[str, np.ndarray], int, int]:
    """Return the times of all round trips by subject, s, and the sizes of a state and a command, bytes."""
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
        client.open_stream(grasp, SKIP_STEP_SETTINGS, validity=TIMEOUT) as idle,
        client.open_stream(grasp, ControlSettings(), validity=TIMEOUT) as stream,
    ):
        subjects: dict[str, Callable[[int], Any]] = {
            "echo": echo(session, "direct", out),
            "echo behind a ring": echo(session, "ring", out),
            "stream without its control step": lambda i: idle.step(*points[i], wait=TIMEOUT),
            "control step": lambda i: controller.step(*points[i]),
            "stream": lambda i: stream.step(*points[i], wait=TIMEOUT),
        }
        time.sleep(0.5)  # s, until both ends know of each other
        for each in (idle, stream):
            each.step(*points[0], wait=TIMEOUT)
        for _ in range(rounds):
            for name, run in subjects.items():
                taken = times.setdefault(name, [])
                tick = time.perf_counter()
                for i in range(BURST):
                    tick = max(tick + PERIOD, time.perf_counter())
                    time.sleep(max(tick - time.perf_counter(), 0.0))
                    start = time.perf_counter()
                    answer = run(i)
                    took = time.perf_counter() - start
                    if i >= WARM_UP:
                        taken.append(took)
                        if name.startswith("stream"):
                            assert answer.sequence == (stream if name == "stream" else idle).sequence  # this state's command
                            assert not answer.forces_reused
                            assert not answer.late
                            times.setdefault(f"{name}, of which in the server", []).append(answer.server_seconds)
    return {name: np.array(taken) for name, taken in times.items()}, len(out), len(back)


def report(times: dict[str, np.ndarray], out: int, back: int) -> str:
    """Return the times as a Markdown page, with machine and versions."""
    lines = [
        "# What a control stream adds to Zenoh",
        "",
        f"graspforce {graspforce.__version__}, {date.today()}. Driver and server are two processes, loopback TCP; the right",
        f"Allegro hand holds a ball with three fingers. A state has {out} bytes, a command {back}. {processor()},",
        f"{os.cpu_count()} cores, Python {platform.python_version()}. The machine is shared: read the ratios.",
        f"Its load is {os.getloadavg()[0]:.1f}.",
        "",
        f"Subjects take turns in bursts of {BURST}, {WARM_UP} to warm up, one round trip a millisecond.",
        "",
        "- The echo is Zenoh alone with messages of the same sizes, answered in Zenoh's receiving thread; behind a ring, from",
        "  a thread of its own, as a server must that takes a while.",
        "- The stream's round trip is `Stream.step`, from arrays to arrays; its part in the server is from the state's receipt",
        "  until its command is ready to be encoded.",
        "- Without its control step it is all that but the step, in whose place the server takes a command made before.",
        "- The control step is `ObjectController.step` in the driver's process.",
        "",
        "| | 10 % µs | median µs | 90 % µs | 99 % µs | max µs |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for name, taken in times.items():
        spread = 1e6 * np.array([*np.quantile(taken, [0.1, 0.5, 0.9, 0.99]), taken.max()])
        lines.append(f"| {name} | " + " | ".join(f"{value:.0f}" for value in spread) + " |")
    median = {name: float(np.median(taken)) for name, taken in times.items()}
    alone = median["stream without its control step"]
    bursts = {name: np.median(taken.reshape(-1, BURST - WARM_UP), axis=1) for name, taken in times.items()}
    low, high = np.quantile(bursts["stream without its control step"] / bursts["echo"], [0.1, 0.9])
    lines += [
        "",
        f"Without its control step the stream takes **{alone / median['echo']:.2f} times the bare echo**, and"
        f" {alone / median['echo behind a ring']:.2f} times the echo",
        f"behind a ring; with it, {median['stream'] / median['echo']:.2f} times the bare echo. Medians over"
        f" {len(times['stream'])} round trips each.",
        f"From one turn of {BURST} to the next the first ratio goes from {low:.2f} to {high:.2f} (10 to 90 %).",
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure and print, with --save write to a file."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.control_stream", description="What a control stream adds to Zenoh."
    )
    parser.add_argument("--rounds", type=int, default=50, help="bursts of each subject")
    parser.add_argument("--save", type=Path, help="write the table as Markdown to this file")
    parser.add_argument("--pin", action="store_true", help="keep the driver on processor 0 and the other process on 1")
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
