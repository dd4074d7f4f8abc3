"""A grasp in ROS 2, with an independent library as the robot: `python -m benchmarks.ros2_stream [--save FILE]`.

Four processes communicate over a router on 127.0.0.1, at the port of ROS 2: the router, `graspforce serve --ros2`, an echo,
and this one. The robot and the echo are sessions of zenoh-ros2-sdk, a library of other authors. The robot lists the node,
its topics and their types, opens the grasp of a box by a service, and sends the joint states of a hand at rest. In the same
run, it sends the same states to the echo: a subscriber of the library that answers each with a message of the size of a
command, by a publisher of the library.

Lost are the states without an answer. At the end, the robot plans a motion and releases the object by services, and a corpus of
random messages goes each way. Their bytes on the wire are compared with those of pycdr2, which shares no code with the node.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support import cdr_types
from support.box_grasp import make_grasp
from support.ros2_peer import HOST, Peer, peer, router
from zenoh_ros2_sdk.discovery import get_service_names_and_types, get_topic_names_and_types

import graspforce
from benchmarks import report_page
from graspforce.service.ros2 import interfaces, messages
from graspforce.service.ros2.key_expressions import NodeName, data_key
from graspforce.service.ros2.node import Node

PORT = 7447  # of the router of ROS 2
NODE = "/graspforce"
ECHO_IN, ECHO_OUT = "/echo/joint_states", "/echo/commands"
CORPUS_IN, CORPUS_OUT = "/corpus/joint_states", "/corpus/commands"
TRIGGER = ("uint8 structure_needs_at_least_one_member", "bool success\nstring message")
REST = 0.5  # s without states before and after the timed ones
TIMEOUT = 30.0  # s
HEADINGS = ("answers by", "states", "answers", "lost", "median ms", "99 % ms", "99.99 % ms", "largest ms")


class Stream(NamedTuple):
    """Times of the states and of their answers, s."""

    sent: list[float]
    answered: list[float]

    def row(self, name: str) -> tuple[str, ...]:
        """Return the row of the table. Without losses, the answers are in the order of the states."""
        lost = len(self.sent) - len(self.answered)
        sent, answered = np.array(self.sent), np.array(self.answered)
        if lost:  # then an answer counts from the last state before it
            sent = sent[np.searchsorted(sent, answered) - 1]
        delays = 1e3 * (answered - sent)
        figures = [*np.percentile(delays, (50.0, 99.0, 99.99)), delays.max()]
        return name, str(len(self.sent)), str(len(self.answered)), str(lost), *(f"{each:.2f}" for each in figures)


class Robot:
    """The robot: joint states of a hand at rest to the node and to the echo, and the times of their answers."""

    def __init__(self, joined: Peer, rate: float) -> None:
        self._joined, self._period, self._grasp = joined, 1.0 / rate, make_grasp()
        self._states = [joined.publisher(topic, messages.JOINT_STATE) for topic in (f"{NODE}/joint_states", ECHO_IN)]
        self._goal = joined.publisher(f"{NODE}/goal_pose", messages.POSE)
        self._types = joined.session.store.types
        self.sent: tuple[list[float], list[float]] = ([], [])
        self.answered: tuple[list[float], list[float]] = ([], [])
        for topic, found in zip((f"{NODE}/commands", ECHO_OUT), self.answered, strict=True):
            joined.subscriber(topic, messages.NUMBERS, lambda message, found=found: found.append(time.perf_counter()))

    def send_states(self, seconds: float) -> None:
        """Send joint states for a time."""
        names, none, start = list(self._grasp.hand.joint_names), np.zeros(0), time.perf_counter()
        for k in range(round(seconds / self._period)):
            time.sleep(max(start + k * self._period - time.perf_counter(), 0.0))
            for publisher, times in zip(self._states, self.sent, strict=True):
                times.append(time.perf_counter())
                publisher.publish(header=self._header(), name=names, position=self._grasp.q, velocity=none, effort=none)

    @contextlib.contextmanager
    def sending(self) -> Iterator[None]:
        """Send joint states until the end of the context, and rest then."""
        stop = threading.Event()

        def send() -> None:
            while not stop.is_set():
                self.send_states(0.1)

        thread = threading.Thread(target=send)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()
        time.sleep(REST)

    def run(self, seconds: float) -> tuple[Stream, Stream]:
        """Send joint states for a time, and return the streams of the node and of the echo."""
        for times in (*self.sent, *self.answered):
            times.clear()
        self.send_states(seconds)
        time.sleep(REST)
        node, echo = (Stream(list(sent), list(back)) for sent, back in zip(self.sent, self.answered, strict=True))
        return node, echo

    def call(self, service: str) -> str:
        """Call a service without fields, and return its message."""
        client, end = self._joined.client(f"{NODE}/{service}", messages.TRIGGER, *TRIGGER), time.monotonic() + TIMEOUT
        while True:  # on a busy machine, the first states or the goal may still be on their way
            response = client.call(structure_needs_at_least_one_member=0)
            if response is not None and response.success:
                return str(response.message)
            if time.monotonic() > end:
                raise SystemExit(f"the service {service} failed: {response and response.message}")
            time.sleep(REST)

    def send_goal(self, rise: float) -> None:
        """Send the pose of the object, risen by a distance in m, as the goal of a plan."""
        point, turn = (self._types[f"geometry_msgs/msg/{name}"] for name in ("Point", "Quaternion"))
        x, y, z = self._grasp.p_HO.tolist()
        pose = self._types["geometry_msgs/msg/Pose"](point(x, y, z + rise), turn(0.0, 0.0, 0.0, 1.0))
        self._goal.publish(header=self._header(), pose=pose)

    def _header(self) -> Any:
        """Return a header with the present time."""
        now = time.time_ns()
        return self._types["std_msgs/msg/Header"](self._types["builtin_interfaces/msg/Time"](now // 10**9, now % 10**9), "")


# ── processes ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _route(listen: str, pipe: Any) -> None:
    """Run a router until the other end of the pipe closes it."""
    with router(listen) as address:
        pipe.send(address)
        pipe.recv()


def _echo(address: str, pipe: Any) -> None:
    """Answer each joint state with a command of as many numbers, by the library alone."""
    with peer(address) as joined:
        answers = joined.publisher(ECHO_OUT, messages.NUMBERS)
        layout = joined.session.store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        answer = lambda message: answers.publish(layout=layout, data=message.position)  # noqa: E731
        joined.subscriber(ECHO_IN, messages.JOINT_STATE, answer)
        pipe.send(None)
        pipe.recv()


@contextlib.contextmanager
def process(target: Callable[..., None], *arguments: str) -> Iterator[Any]:
    """Run a function in a process, and yield the first object that it sends."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    child = context.Process(target=target, args=(*arguments, there))
    child.start()
    try:
        yield here.recv()
        here.send(None)
        child.join(TIMEOUT)
    finally:
        child.kill()


@contextlib.contextmanager
def served_grasp(address: str, rate: float) -> Iterator[None]:
    """Serve the grasp as a node."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "grasp.json"
        make_grasp().save(file)
        settings = [f"rate={rate:g}", "domain=0", "slip_margin=0.3"]
        command = [sys.executable, "-m", "graspforce", "serve", "--hand", "four_finger", "--listen", "tcp/127.0.0.1:0"]
        command += ["--ros2", address, "--grasp", str(file), *(part for text in settings for part in ("--ros2-setting", text))]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            child.stdout.readline()
            try:
                yield
            finally:
                child.terminate()


# ── corpus ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _wait(is_done: Callable[[], bool]) -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + TIMEOUT
    while not is_done():
        if time.monotonic() > end:
            raise SystemExit("the messages of the corpus did not arrive")
        time.sleep(0.01)


def corpus(joined: Peer, count: int) -> tuple[int, int]:
    """Send random messages each way. Return how many of each way have the bytes of pycdr2 on the wire and once read."""
    source, rng, session = random.Random(1), np.random.default_rng(1), joined.session.session
    raw: list[bytes] = []
    read: list[Any] = []
    with Node(session, NodeName("corpus")) as node:
        node.subscribe(CORPUS_IN, messages.JOINT_STATE, read.append)
        listener = session.declare_subscriber(
            data_key(0, CORPUS_IN, messages.JOINT_STATE), lambda sample: raw.append(sample.payload.to_bytes())
        )
        states, expected = joined.publisher(CORPUS_IN, messages.JOINT_STATE), []
        types = joined.session.store.types
        for k in range(count):
            names = ["".join(source.choices("abcdefgh_ 12äΩ", k=source.randrange(12))) for _ in range(source.randrange(6))]
            arrays = [rng.normal(scale=100.0, size=len(names)) for _ in range(3)]
            stamp = source.randrange(-(2**31), 2**31), source.randrange(10**9)
            header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](*stamp), f"frame {k}")
            theirs = cdr_types.Header(cdr_types.Time(*stamp), f"frame {k}")
            expected.append(cdr_types.JointState(theirs, names, *(each.tolist() for each in arrays)).serialize())
            states.publish(header=header, name=names, position=arrays[0], velocity=arrays[1], effort=arrays[2])
            if k % 5 == 4 or k == count - 1:
                _wait(lambda n=k + 1: len(raw) == n and len(read) == n)
        listener.undeclare()
        back = [interfaces.encode(messages.JOINT_STATE, message) for message in read]
        inwards = sum(a == b == c for a, b, c in zip(expected, raw, back, strict=True))
        return inwards, _outwards(node, joined, count, rng)


def _outwards(node: Node, joined: Peer, count: int, rng: np.random.Generator) -> int:
    """Send random commands from the node to the library. Return how many have the bytes of pycdr2."""
    raw: list[bytes] = []
    read: list[Any] = []
    key = data_key(0, CORPUS_OUT, messages.NUMBERS)
    listener = joined.session.session.declare_subscriber(key, lambda sample: raw.append(sample.payload.to_bytes()))
    joined.subscriber(CORPUS_OUT, messages.NUMBERS, read.append)
    publisher, expected = node.publish(CORPUS_OUT, messages.NUMBERS), []
    for k in range(count):
        values = rng.normal(scale=10.0, size=int(rng.integers(1, 30)))
        layout = cdr_types.MultiArrayLayout([], 0)
        expected.append(cdr_types.Float64MultiArray(layout, values.tolist()).serialize())
        publisher.publish(messages.make_numbers(values))
        if k % 5 == 4 or k == count - 1:
            _wait(lambda n=k + 1: len(raw) == n and len(read) == n)
    listener.undeclare()
    store = joined.session.store
    back = [bytes(store.serialize_cdr(message, messages.NUMBERS)) for message in read]
    return sum(a == b == c for a, b, c in zip(expected, raw, back, strict=True))


# ── page ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def listing(port: int) -> str:
    """Return the topics and services of the node, as the library lists them, as a table."""
    topics = get_topic_names_and_types(0, HOST, port)
    services = get_service_names_and_types(0, HOST, port)
    rows = [("topic", name, ", ".join(types)) for name, types in sorted(topics)]
    rows += [("service", name, ", ".join(types)) for name, types in sorted(services)]
    shown = [row for row in rows if row[1].startswith((NODE, "/diagnostics"))]
    return report_page.table(("kind", "name", "type"), shown, text_columns=3)


def measure(port: int, rate: float, seconds: float, count: int) -> list[str]:
    """Run all parts, and return the parts of the page."""
    listen = f"tcp/{HOST}:{port}"
    with process(_route, listen) as address, process(_echo, address), served_grasp(address, rate), peer(address) as joined:
        found = listing(joined.port)
        robot = Robot(joined, rate)
        with robot.sending():
            time.sleep(REST)
            answers = [robot.call("open")]
            time.sleep(REST)
        node, echo = robot.run(seconds)
        with robot.sending():  # the hand does not follow the commands: a plan begins from a new grasp
            time.sleep(REST)
            answers += [robot.call("release"), robot.call("open")]
            robot.send_goal(0.002)
            time.sleep(REST)
            answers += [robot.call("plan"), robot.call("release")]
        inwards, outwards = corpus(joined, count)
    head = (HEADINGS, (node.row("the node"), echo.row("an echo of the library")))
    report_page.show("States and their answers", *head)
    return [
        f"{rate:g} states a second for {seconds:g} s, through a router at port {joined.port}. "
        f"Load average: {os.getloadavg()[0]:.1f}.",
        report_page.table(*head),
        f"Services: open, {answers[0]!r}; plan, {answers[3]!r}; release, {answers[4]!r}.",
        f"Corpus: {inwards} of {count} joint states from the library and {outwards} of {count} commands to the library are "
        "byte-equal: those of pycdr2, those on the wire, and those encoded again after reading.",
        "Topics and services as the library lists them:",
        found,
    ]


def main() -> None:
    """Measure, print the tables and write the page."""
    parser = report_page.parser("ros2_stream", __doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="time of the stream, s (default: 60)")
    parser.add_argument("--rate", type=float, default=500.0, help="joint states per second, Hz (default: 500)")
    parser.add_argument("--corpus", type=int, default=1000, help="messages each way (default: 1000)")
    parser.add_argument("--port", type=int, default=PORT, help=f"port of the router; 0 for a free one (default: {PORT})")
    options = parser.parse_args()
    parts = measure(options.port, options.rate, options.seconds, options.corpus)
    print("\n\n".join(parts))
    if options.save:
        facts = report_page.facts(f"graspforce {graspforce.__version__}")
        report_page.save(options.save, "A grasp in ROS 2", __doc__, facts, "\n\n".join(parts))


if __name__ == "__main__":
    main()
