"""A stream as its driver holds it, against a server that is a function: what it hands on, keeps, waits for and raises."""

from __future__ import annotations

import inspect
import threading
import time
from collections import deque

import numpy as np
import pytest
from support.control_requests import EXTERNAL, GRASP, HAND, desired, setup, state

from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspState, ObjectController
from graspforce.core.errors import ErrorReply, InvalidInput, NoServer, ServiceTimeout
from graspforce.service import Stream, StreamSetup, Watchdog
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.server.stream_registry import StreamRegistry
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import MSGPACK

PATIENCE = 20.0  # s: no test waits for it unless it fails
VALIDITY = 0.05  # s
DOG = Watchdog(hold=0.1, ramp=0.1, floor=0.25, step=0.04)


class World:
    """A server in this process, as a link to it: it can be away, or slow, and its streams are the real ones."""

    def __init__(self):
        self.streams = StreamRegistry({HAND.name: HAND}, capacity=4, idle_timeout=10.0)
        self.away = self.silent = False
        self.asked, self.closed = [], False
        self.payloads = []
        self.box = deque(maxlen=1)

    def query(self, record):
        self.asked.append(record)
        if self.away:
            raise NoServer("no server is alive")
        return self.streams.answer("a", protocol.decode(protocol.encode(record, MSGPACK), MSGPACK))

    def connect(self):
        return self

    def take_in(self, payload, encoding):
        self.box.append((payload, encoding))

    def receive(self):
        return self.box.popleft() if self.box else None

    def send(self, payload):
        self.payloads.append(payload)
        if not self.away and not self.silent and len(self.streams):
            self.reply(payload)

    def reply(self, payload):
        reply = self.streams["a"].command(payload, MSGPACK)
        self.take_in(reply.payload, reply.encoding)

    def close(self):
        self.closed = True


@pytest.fixture
def world():
    return World()


@pytest.fixture
def open_stream(world):
    """Opens a stream in the world; closed at the end."""
    held = []

    def start(opened: StreamSetup | None = None, **change) -> Stream:
        said = {
            "watchdog": DOG,
            "codec": MSGPACK,
            "timeout": PATIENCE,
            "query": world.query,
            "connect": world.connect,
            **change,
        }
        held.append(Stream("a", opened or setup(validity=VALIDITY, memory=None), **said))
        return held[-1]

    yield start
    for stream in held:
        stream.close()


def wait_until(is_met):
    deadline = time.monotonic() + PATIENCE
    while not is_met():
        assert time.monotonic() < deadline, "it never held"
        time.sleep(0.002)


def test_it_stands_wherever_a_controller_can(open_stream):
    wanted, given = (list(inspect.signature(kind.step).parameters.values()) for kind in (ObjectController, Stream))
    assert [each.name for each in given[: len(wanted)]] == [each.name for each in wanted]
    assert all(each.kind is each.KEYWORD_ONLY and each.default is None for each in given[len(wanted) :])
    stream, controller = open_stream(), ObjectController(GRASP, setup().settings)
    for i in range(5):
        remote, here = (each.step(state(i), desired(), EXTERNAL) for each in (stream, controller))
        np.testing.assert_allclose(remote.tau, here.tau, rtol=1e-9, atol=1e-12)
        assert (remote.sequence, remote.late, remote.resuming) == (i + 1, False, False)
        assert 0.0 <= remote.age <= VALIDITY


def test_publishing_waits_for_nothing_and_latest_is_the_newest(open_stream, world):
    stream = open_stream()
    assert stream.latest() is None
    world.silent = True
    numbers = [stream.publish(state(i), desired()) for i in range(3)]
    assert numbers == [1, 2, 3]
    assert stream.latest() is None
    for payload in world.payloads[1:]:
        world.reply(payload)
    assert stream.latest().sequence == 3
    world.reply(world.payloads[0])  # overtaken: not good
    assert stream.latest().sequence == 3


def test_a_step_waits_for_its_own_command(open_stream, world):
    stream = open_stream(setup(validity=PATIENCE, memory=None))
    stream.step(state(), desired())
    world.silent = True
    thread = threading.Timer(0.05, lambda: [world.reply(payload) for payload in world.payloads[-1:]])
    thread.start()
    assert stream.step(state(1), desired(), wait=PATIENCE).sequence == 2
    thread.join()
    # and no longer than it is told to: then the last good one stands
    assert stream.step(state(2), desired()).sequence == 2


def test_a_command_that_comes_too_late_is_not_used(open_stream, world):
    stream = open_stream()
    good = stream.step(state(), desired())
    world.silent = True
    stream.publish(state(1), desired())
    time.sleep(1.5 * VALIDITY)
    world.reply(world.payloads[-1])
    command = stream.latest()
    assert command.late
    assert command.sequence == good.sequence
    assert command.age > VALIDITY
    assert "no command arrived: the watchdog is active" in command.warnings[-1]


def test_without_commands_the_torque_relaxes_and_when_they_come_again_it_returns_by_bounded_steps(open_stream, world):
    stream = open_stream()
    before = stream.step(state(), desired())
    world.streams.close()  # the server is another: it knows of no stream
    world.away = True
    commands = [before]

    def met(is_met):
        commands.append(stream.step(state(), desired()))
        return is_met(commands[-1])

    wait_until(lambda: met(lambda command: command.age > DOG.hold + DOG.ramp))
    np.testing.assert_allclose(commands[-1].tau, DOG.floor * before.tau, rtol=0, atol=DOG.step)
    assert isinstance(stream.last_error, NoServer)
    assert commands[-1].late
    world.away = False
    wait_until(lambda: met(lambda command: not command.late and not command.resuming))
    assert stream.last_error is None
    steps = np.abs(np.diff([command.tau for command in commands], axis=0))  # N·m
    assert steps.max() <= DOG.step * (1.0 + 1e-9)  # rounding
    # it was opened again with what the last good command left, and goes on from there
    again = world.asked[-1]
    np.testing.assert_array_equal(np.array(again["memory"]["integral"]), before.memory.integral)


def test_a_driver_that_pauses_is_not_missed(open_stream, world):
    stream = open_stream()
    stream.step(state(), desired())
    stream._sent_time -= 10.0  # s: as if nothing had been sent for so long
    stream._last_received -= 10.0
    asked = len(world.asked)
    time.sleep(0.2)  # four times the keeper's patience
    assert len(world.asked) == asked


def test_the_very_first_command_must_come(open_stream, world):
    world.silent = True
    stream = open_stream(timeout=0.1)
    with pytest.raises(ServiceTimeout, match=r"no command within 0\.1 s"):
        stream.step(state(), desired())


def test_what_the_server_refuses_at_first_is_raised_and_later_only_said(open_stream, world, monkeypatch):
    stream = open_stream()
    fine = ServerStream.command
    monkeypatch.setattr(ServerStream, "command", lambda self, payload, encoding: fine(self, b"{}", None))
    with pytest.raises(ErrorReply, match="Missing field 'sequence'") as caught:
        stream.step(state(), desired())
    assert (caught.value.code, caught.value.field) == ("invalid", "sequence")
    monkeypatch.setattr(ServerStream, "command", fine)
    good = stream.step(state(), desired())
    monkeypatch.setattr(ServerStream, "command", lambda self, payload, encoding: fine(self, b"{}", None))
    command = stream.step(state(), desired())
    np.testing.assert_array_equal(command.tau, good.tau)
    assert "sequence" in str(stream.last_error)


@pytest.mark.parametrize("payload", [b"", b"\xc1", b"{}", b'{"error": "odd"}', b"[1]"])
def test_an_answer_that_cannot_be_read_is_trouble_and_no_torque(open_stream, world, payload):
    stream = open_stream()
    good = stream.step(state(), desired())
    for encoding in ("application/json", MSGPACK, "text/plain"):
        world.take_in(payload, encoding)
        np.testing.assert_array_equal(stream.latest().tau, good.tau)
        assert isinstance(stream.last_error, ErrorReply)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"torque": [0.0] * 11}, "the server's torque is invalid"),
        ({"torque": [0.0] * 11 + [float("nan")]}, "the server's torque is invalid"),
        ({"positions": [[0.0, 1.0, 2.0], [0.0]]}, "cannot be read"),
        ({"time": float("nan")}, None),  # of no state that was sent
        ({"time": 1e18}, None),
        ({"late": True}, None),
    ],
)
def test_a_command_that_is_none_never_reaches_the_motors(open_stream, world, change, said):
    stream = open_stream(setup(validity=PATIENCE, memory=None))
    good = stream.step(state(), desired())
    world.silent = True
    stream.publish(state(1), desired())
    reply = world.streams["a"].command(world.payloads[-1], MSGPACK)
    world.take_in(protocol.encode({**protocol.decode(reply.payload, MSGPACK), **change}, MSGPACK), MSGPACK)
    command = stream.latest()
    assert (command.sequence, command.late) == (1, False)
    np.testing.assert_array_equal(command.tau, good.tau)
    assert (stream.last_error is None) if said is None else (said in str(stream.last_error))
    world.take_in(reply.payload, MSGPACK)
    assert stream.latest().sequence == 2
    assert stream.last_error is None


def test_a_server_that_cannot_take_what_was_left_begins_afresh(open_stream, world):
    stream = open_stream()
    before = stream.step(state(), desired())
    world.streams.close()
    query = world.streams.answer

    def particular(id, record):
        if "memory" in record:
            raise ErrorReply("invalid", "memory = 3: must be another", "memory")
        return query(id, record)

    world.streams.answer = particular
    wait_until(lambda: stream.step(state(), desired()).sequence > before.sequence)
    assert len(world.streams) == 1


def test_a_state_of_another_hand_is_refused_here(open_stream, world):
    stream = open_stream()
    with pytest.raises(InvalidInput, match="one for each motor of four_finger"):
        stream.step(GraspState(np.zeros(3), np.zeros(3), BodyMotion(np.zeros(3), np.eye(3))), desired())
    with pytest.raises(InvalidInput, match="external"):
        stream.publish(state(), desired(), [0.0])
    assert world.payloads == []


def test_a_stream_that_cannot_be_opened_leaves_nothing(open_stream, world):
    world.away = True
    with pytest.raises(NoServer):
        open_stream()
    assert world.closed


def test_closing_closes_both_ends_once(open_stream, world):
    stream = open_stream()
    with stream:
        stream.step(state(), desired())
        assert len(world.streams) == 1
    assert (len(world.streams), world.closed, world.asked[-1]) == (0, True, {"close": True})
    asked = len(world.asked)
    stream.close()
    assert len(world.asked) == asked
