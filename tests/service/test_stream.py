"""The client's stream against a server in the same process: commands, waiting, errors and reconnection."""

from __future__ import annotations

import inspect
import threading
import time

import numpy as np
import pytest
from support.control_requests import EXTERNAL, GRASP, HAND, desired, setup, state
from support.local_server import LocalServer

from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspState, ObjectController
from graspforce.core.errors import ErrorReply, InvalidInput, NoServer, ServiceTimeout
from graspforce.service import Stream, StreamSetup, Watchdog
from graspforce.service.client.command_stream import StreamLink
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import MSGPACK

TIMEOUT = 20.0  # s, only a failing test waits so long
VALIDITY = 0.05  # s
DOG = Watchdog(hold=0.1, ramp=0.1, floor=0.25, step=0.04)


@pytest.fixture
def server():
    return LocalServer()


@pytest.fixture
def open_stream(server):
    """Return a function that opens a stream; the streams are closed at the end."""
    opened = []

    def start(stream_setup: StreamSetup | None = None, **change) -> Stream:
        options = {
            "watchdog": DOG,
            "codec": MSGPACK,
            "timeout": TIMEOUT,
            "query": server.query,
            "connect": server.connect,
            **change,
        }
        opened.append(Stream("a", stream_setup or setup(validity=VALIDITY, memory=None), StreamLink(**options)))
        return opened[-1]

    yield start
    for stream in opened:
        stream.close()


def wait_until(is_met):
    deadline = time.monotonic() + TIMEOUT
    while not is_met():
        assert time.monotonic() < deadline, "the condition was not met in time"
        time.sleep(0.002)


def test_stream_has_the_interface_and_results_of_a_controller(open_stream):
    expected, actual = (list(inspect.signature(kind.step).parameters.values()) for kind in (ObjectController, Stream))
    assert [each.name for each in actual[: len(expected)]] == [each.name for each in expected]
    assert all(each.kind is each.KEYWORD_ONLY and each.default is None for each in actual[len(expected) :])
    stream, controller = open_stream(), ObjectController(GRASP, setup().settings)
    for i in range(5):
        remote, here = (each.step(state(i), desired(), EXTERNAL) for each in (stream, controller))
        np.testing.assert_allclose(remote.tau, here.tau, rtol=1e-9, atol=1e-12)
        assert (remote.sequence, remote.late, remote.resuming) == (i + 1, False, False)
        assert 0.0 <= remote.age <= VALIDITY


def test_publish_does_not_wait_and_latest_returns_the_newest_command(open_stream, server):
    stream = open_stream()
    assert stream.latest() is None
    server.silent = True
    numbers = [stream.publish(state(i), desired()) for i in range(3)]
    assert numbers == [1, 2, 3]
    assert stream.latest() is None
    for payload in server.payloads[1:]:
        server.reply(payload)
    assert stream.latest().sequence == 3
    server.reply(server.payloads[0])  # older than the last good one
    assert stream.latest().sequence == 3


def test_step_waits_for_its_own_command(open_stream, server):
    stream = open_stream(setup(validity=TIMEOUT, memory=None))
    stream.step(state(), desired())
    server.silent = True
    thread = threading.Timer(0.05, lambda: [server.reply(payload) for payload in server.payloads[-1:]])
    thread.start()
    assert stream.step(state(1), desired(), wait=TIMEOUT).sequence == 2
    thread.join()
    # it waits no longer than `wait`, and then returns the last good command
    assert stream.step(state(2), desired()).sequence == 2


def test_late_command_is_not_used(open_stream, server):
    stream = open_stream()
    good = stream.step(state(), desired())
    server.silent = True
    stream.publish(state(1), desired())
    time.sleep(1.5 * VALIDITY)
    server.reply(server.payloads[-1])
    command = stream.latest()
    assert command.late
    assert command.sequence == good.sequence
    assert command.age > VALIDITY
    assert "no command arrived: the watchdog is active" in command.warnings[-1]


def test_command_prints_its_phase_and_contacts(open_stream, server):
    stream, commands = open_stream(), []

    def is_in_time():
        commands.append(stream.step(state(), desired()))
        return not commands[-1].late and not commands[-1].resuming

    wait_until(is_in_time)
    lines = str(commands[-1]).splitlines()
    assert lines[0].startswith(f"command {commands[-1].sequence} for {HAND.name}: in time, age ")
    assert [line.split()[0] for line in lines[2:6]] == list(GRASP.fingers)
    server.away = True
    time.sleep(1.5 * VALIDITY)
    text = str(stream.latest())
    assert "late, torque of the watchdog" in text
    assert "warning: " in text


def test_torque_ramps_down_without_commands_and_returns_by_bounded_steps(open_stream, server):
    stream = open_stream()
    before = stream.step(state(), desired())
    server.streams.close()  # a restarted server has no streams
    server.away = True
    commands = [before]

    def met(is_met):
        commands.append(stream.step(state(), desired()))
        return is_met(commands[-1])

    wait_until(lambda: met(lambda command: command.age > DOG.hold + DOG.ramp))
    np.testing.assert_allclose(commands[-1].tau, DOG.floor * before.tau, rtol=0, atol=DOG.step)
    assert isinstance(stream.last_error, NoServer)
    assert commands[-1].late
    server.away = False
    wait_until(lambda: met(lambda command: not command.late and not command.resuming))
    assert stream.last_error is None
    steps = np.abs(np.diff([command.tau for command in commands], axis=0))  # N·m
    assert steps.max() <= DOG.step * (1.0 + 1e-9)  # rounding
    # it was opened again with the memory of the last good command
    again = server.asked[-1]
    np.testing.assert_array_equal(np.array(again["memory"]["integral"]), before.memory.integral)


def test_paused_driver_causes_no_reconnection(open_stream, server):
    stream = open_stream()
    stream.step(state(), desired())
    stream._sent_time -= 10.0  # s, as if the driver had paused
    stream._last_received -= 10.0
    asked = len(server.asked)
    time.sleep(0.2)  # several retry periods
    assert len(server.asked) == asked


def test_missing_first_command_is_a_timeout(open_stream, server):
    server.silent = True
    stream = open_stream(timeout=0.1)
    with pytest.raises(ServiceTimeout, match=r"no command within 0\.1 s"):
        stream.step(state(), desired())


def test_first_error_is_raised_and_later_ones_are_stored(open_stream, server, monkeypatch):
    stream = open_stream()
    original = ServerStream.command
    monkeypatch.setattr(ServerStream, "command", lambda self, payload, encoding: original(self, b"{}", None))
    with pytest.raises(ErrorReply, match="Missing field 'sequence'") as caught:
        stream.step(state(), desired())
    assert (caught.value.code, caught.value.field) == ("invalid", "sequence")
    monkeypatch.setattr(ServerStream, "command", original)
    good = stream.step(state(), desired())
    monkeypatch.setattr(ServerStream, "command", lambda self, payload, encoding: original(self, b"{}", None))
    command = stream.step(state(), desired())
    np.testing.assert_array_equal(command.tau, good.tau)
    assert "sequence" in str(stream.last_error)


@pytest.mark.parametrize("payload", [b"", b"\xc1", b"{}", b'{"error": "odd"}', b"[1]"])
def test_unreadable_answer_sets_last_error_and_keeps_the_torque(open_stream, server, payload):
    stream = open_stream()
    good = stream.step(state(), desired())
    for encoding in ("application/json", MSGPACK, "text/plain"):
        server.take_in(payload, encoding)
        np.testing.assert_array_equal(stream.latest().tau, good.tau)
        assert isinstance(stream.last_error, ErrorReply)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"torque": [0.0] * 11}, "the server's torque is invalid"),
        ({"torque": [0.0] * 11 + [float("nan")]}, "the server's torque is invalid"),
        ({"positions": [[0.0, 1.0, 2.0], [0.0]]}, "cannot be read"),
        ({"time": float("nan")}, None),  # of no state
        ({"time": 1e18}, None),
        ({"late": True}, None),
    ],
)
def test_invalid_command_never_reaches_the_motors(open_stream, server, change, message):
    stream = open_stream(setup(validity=TIMEOUT, memory=None))
    good = stream.step(state(), desired())
    server.silent = True
    stream.publish(state(1), desired())
    reply = server.streams["a"].command(server.payloads[-1], MSGPACK)
    server.take_in(protocol.encode({**protocol.decode(reply.payload, MSGPACK), **change}, MSGPACK), MSGPACK)
    command = stream.latest()
    assert (command.sequence, command.late) == (1, False)
    np.testing.assert_array_equal(command.tau, good.tau)
    assert (stream.last_error is None) if message is None else (message in str(stream.last_error))
    server.take_in(reply.payload, MSGPACK)
    assert stream.latest().sequence == 2
    assert stream.last_error is None


def test_stream_restarts_without_memory_if_the_server_rejects_it(open_stream, server):
    stream = open_stream()
    before = stream.step(state(), desired())
    server.streams.close()
    query = server.streams.answer

    def reject_memory(id, record):
        if "memory" in record:
            raise ErrorReply("invalid", "memory = 3: must be another", "memory")
        return query(id, record)

    server.streams.answer = reject_memory
    wait_until(lambda: stream.step(state(), desired()).sequence > before.sequence)
    assert len(server.streams) == 1


def test_state_of_another_hand_is_rejected_by_the_client(open_stream, server):
    stream = open_stream()
    with pytest.raises(InvalidInput, match="one for each motor of four_finger"):
        stream.step(GraspState(np.zeros(3), np.zeros(3), BodyMotion(np.zeros(3), np.eye(3))), desired())
    with pytest.raises(InvalidInput, match="external"):
        stream.publish(state(), desired(), [0.0])
    assert server.payloads == []


def test_stream_that_cannot_be_opened_closes_its_connection(open_stream, server):
    server.away = True
    with pytest.raises(NoServer):
        open_stream()
    assert server.closed


def test_close_closes_both_ends_once(open_stream, server):
    stream = open_stream()
    with stream:
        stream.step(state(), desired())
        assert len(server.streams) == 1
    assert (len(server.streams), server.closed, server.asked[-1]) == (0, True, {"close": True})
    asked = len(server.asked)
    stream.close()
    assert len(server.asked) == asked
