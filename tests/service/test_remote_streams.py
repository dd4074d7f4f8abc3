"""Control streams over Zenoh: server restarts, and clients that flood, freeze or die."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import zenoh
from support.control_requests import EXTERNAL, GRASP, HAND, SETTINGS, desired, request, setup, state, stream_state
from support.servers import ANY_LOCAL_PORT, TIMEOUT, plain_session, python_process, server_process, suspend, wait_until

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController
from graspforce.core.errors import ErrorReply, InvalidInput, NoServer, RequestRefused, ServiceError
from graspforce.service import Client, Server, ServerLimits, StreamSetup, Watchdog
from graspforce.service.wire import protocol

TESTS = str(Path(__file__).parents[1])

# A driver in a child process: it prints the id of its stream, then floods it with states and reads no commands.
FLOOD = """
import os, signal, sys
sys.path.insert(0, sys.argv[2])
from support.control_requests import GRASP, desired, state
from graspforce.service import Client
client = Client(sys.argv[1], timeout=20.0)
stream = client.open_stream(GRASP)
measured, motion = state(), desired()
stream.step(measured, motion)
print(stream.id, flush=True)
if "die" in sys.argv:
    os.kill(os.getpid(), signal.SIGKILL)
while True:
    stream.publish(measured, motion)
"""

PERIOD = SETTINGS.period  # s


UNREAD = """
import json, sys, time
sys.path.insert(0, sys.argv[2])
from support.control_requests import setup
from support.servers import plain_session
session = plain_session(sys.argv[1])
commands = session.declare_subscriber("graspforce/1/streams/unread/command", lambda sample: None)
list(session.get("graspforce/1/streams/unread", payload=json.dumps(setup(memory=None).to_dict())))
print("unread", flush=True)
time.sleep(600)
"""


@pytest.fixture
def flooder(server):
    """Run a process that floods its stream with states."""
    with python_process(FLOOD, server.addresses[0], TESTS) as flooding:
        yield flooding


def streams(client):
    return client.status().streams


# ── streams ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("encoding", ["msgpack", "json"])
def test_stream_and_query_return_the_commands_of_a_local_controller(server, encoding):
    controller = ObjectController(GRASP, SETTINGS)
    with Client(server.addresses[0], timeout=TIMEOUT, encoding=encoding) as client:
        with client.open_stream(GRASP, SETTINGS, validity=TIMEOUT) as stream:
            memory = None
            for i in range(10):
                command = controller.step(state(i), desired(), EXTERNAL)
                streamed = stream.step(state(i), desired(), EXTERNAL, wait=TIMEOUT)
                queried = client.control(request(state=state(i), memory=memory))
                memory = queried.memory
                assert streamed.sequence == i + 1
                np.testing.assert_allclose(streamed.tau, command.tau, rtol=1e-9, atol=1e-12)
                # a cold start: with a cost accurate to 1e-8, the torques are accurate to about the square root of that
                np.testing.assert_allclose(queried.tau, command.tau, rtol=0, atol=1e-4 * np.abs(command.tau).max())
                np.testing.assert_allclose(queried.acceleration, command.acceleration, rtol=1e-9)
                assert queried.solution.certificate.verified
            assert streams(client) == 1
        status = client.status()
        assert status.streams == 0
        assert status.counts[f"hands/{HAND.name}/control"]["ok"] >= 10
        assert status.counts["streams/*/state"]["ok"] >= 10


def test_plain_zenoh_session_streams_in_json(server):
    with plain_session(server.addresses[0]) as session:
        commands = session.declare_subscriber("graspforce/1/streams/mine/command", zenoh.handlers.RingChannel(1))
        record = json.dumps(protocol.decode(protocol.encode(setup().to_dict(), protocol.JSON), protocol.JSON))
        [reply] = session.get("graspforce/1/streams/mine", payload=record, timeout=TIMEOUT)
        assert json.loads(reply.ok.payload.to_bytes())["opened"] is True
        session.put("graspforce/1/streams/mine/state", protocol.encode(stream_state(41).to_dict(), protocol.JSON))
        sample = commands.recv()
        command = json.loads(sample.payload.to_bytes())
        assert (str(sample.encoding), command["sequence"], len(command["torque"])) == (protocol.JSON, 41, HAND.n)
        session.put("graspforce/1/streams/mine/state", "{}")
        assert json.loads(commands.recv().payload.to_bytes())["error"] == "invalid"
        [reply] = session.get("graspforce/1/streams/mine", payload='{"close": true}', timeout=TIMEOUT)
        assert json.loads(reply.ok.payload.to_bytes())["outcomes"] == {"ok": 1, "invalid": 1}
        assert list(session.get("graspforce/1/streams/*", payload=record, timeout=TIMEOUT)) == []


def test_invalid_setup_gets_the_message_of_python_and_opens_no_stream(client):
    before = streams(client)
    bad = {**setup().to_dict(), "validity": -1.0}
    with pytest.raises(InvalidInput) as caught:
        StreamSetup.from_dict({HAND.name: HAND}, bad)
    with pytest.raises(ErrorReply) as replied:
        client.query("streams/x", bad)
    assert (str(replied.value), replied.value.field) == (str(caught.value), "validity")
    assert streams(client) == before


def test_number_of_open_streams_is_limited():
    with (
        Server([HAND], listen=ANY_LOCAL_PORT, limits=ServerLimits(streams=1)) as server,
        Client(server.addresses[0], timeout=TIMEOUT) as client,
    ):
        with client.open_stream(GRASP), pytest.raises(RequestRefused, match="1 streams are open"):
            client.open_stream(GRASP)
        client.open_stream(GRASP).step(state(), desired())


# ── server restart ────────────────────────────────────────────────────────────────────────────────────────


class Plant:
    """An object on a sinusoid of 10 mm at 1 Hz with a constant lag of 0.1 mm, and a hand at rest."""

    def __init__(self):
        self.start = time.monotonic()

    def now(self):
        """Return (state, desired) now."""
        phase, amplitude, rate = 2.0 * np.pi * (time.monotonic() - self.start), 5e-3, 2.0 * np.pi  # rad, m, rad/s
        x, v, a = amplitude * np.sin(phase), amplitude * rate * np.cos(phase), -amplitude * rate**2 * np.sin(phase)
        along = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        motion = BodyMotion(GRASP.p_HO + x * along[:3], GRASP.R_HO, v * along, a * along)
        lagging = BodyMotion(GRASP.p_HO + (x - 1e-4) * along[:3], GRASP.R_HO, v * along)
        return GraspState(GRASP.q, np.zeros(HAND.n), lagging), motion


def test_stream_survives_a_server_restart_with_bounded_torque_steps():
    """The watchdog holds the torque for a second, ramps it down, and the stream resumes by bounded steps."""
    dog = Watchdog(hold=1.0, ramp=0.5, floor=0.4, step=0.005)
    plant, commands = Plant(), []
    with server_process(HAND.name) as (first, address), Client(address, timeout=TIMEOUT) as client:
        stream = client.open_stream(GRASP, ControlSettings(period=PERIOD), validity=0.1, watchdog=dog)

        def drive(is_met):
            """Run the driver's loop until its last command meets a condition; return the number of commands."""
            deadline = time.monotonic() + TIMEOUT
            while not commands or not is_met(commands[-1]):
                assert time.monotonic() < deadline, "the condition was not met in time"
                began = time.monotonic()
                commands.append(stream.step(*plant.now()))
                time.sleep(max(PERIOD - (time.monotonic() - began), 0.0))
            return len(commands)

        drive(lambda command: command.sequence > 200 and not command.late and not command.resuming)
        first.kill()
        first.wait(TIMEOUT)
        hold_end = drive(lambda command: command.age > dog.hold) - 1
        relaxed = drive(lambda command: command.age > dog.hold + dog.ramp + 0.2)
        assert isinstance(stream.last_error, ServiceError)
        with server_process(HAND.name, listen=address) as (_, again):
            assert again == address
            resumed = drive(lambda command: not command.late and not command.resuming)
            drive(lambda command: len(commands) > resumed + 100)
            assert stream.last_error is None
            assert streams(client) == 1
            stream.close()
            assert streams(client) == 0

    taus = np.array([command.tau for command in commands])
    late = np.array([command.late for command in commands])
    lost = np.flatnonzero(~late[:hold_end])[-1]  # the last good command
    # the torque is held for a second, with a command for each state
    assert commands[hold_end - 1].age > 0.9 * dog.hold
    assert hold_end - lost > 20  # on an idle machine 200: a busy one runs the driver's loop more slowly
    np.testing.assert_allclose(taus[lost:hold_end], np.tile(taus[lost], (hold_end - lost, 1)), atol=1e-12)
    # then it falls along the ramp to the floor
    np.testing.assert_allclose(taus[relaxed - 1], dog.floor * taus[lost], atol=1e-12)
    # until the commands are reached, no step exceeds the bound, although the difference does
    steps = np.abs(np.diff(taus[lost:resumed], axis=0))
    assert steps.max() <= dog.step * (1.0 + 1e-9)  # rounding
    assert np.abs(taus[relaxed - 1] - taus[resumed - 1]).max() > dog.step


def test_closing_server_closes_its_streams():
    with Server([HAND], listen=ANY_LOCAL_PORT) as server:
        client = Client(server.addresses[0], timeout=1.0)
        stream = client.open_stream(GRASP)
        stream.step(state(), desired())
        threads = [thread for thread in threading.enumerate() if thread.name == f"stream-{stream.id}"]
        assert len(threads) == 1
    with client:
        assert not threads[0].is_alive()
        wait_until(lambda: stream.step(state(), desired()).late and isinstance(stream.last_error, NoServer))


# ── misbehaving clients ─────────────────────────────────────────────────────────────────────────────────────────────


def count_in_time(stream, count=100):
    """Return how many of `count` steps get their own command."""
    return sum(stream.step(state(i), desired(), wait=TIMEOUT).sequence == stream.sequence for i in range(count))


def test_flood_of_states_delays_no_other_stream_and_only_newest_states_are_used(server, client, flooder):
    child, id = flooder
    with client.open_stream(GRASP, validity=TIMEOUT) as stream:
        assert count_in_time(stream) == 100
        assert client.control(request()).solution.found
        flooded = server._handler.streams[id]
        child.kill()
        child.wait(TIMEOUT)
        assert flooded.outcomes["ok"] > 0
        assert flooded.skipped > 0


def test_client_that_stops_reading_commands_delays_no_other_stream(server, client):
    """16 MB of unread answers exceed the buffers of sockets and queues."""
    with (
        python_process(UNREAD, server.addresses[0], TESTS) as (child, id),
        client.open_stream(GRASP, validity=TIMEOUT) as stream,
        plain_session(server.addresses[0]) as session,
    ):
        suspend(child)
        outcomes, bad = server._handler.streams[id].outcomes, json.dumps({"x" * 4000: 1})
        began = outcomes["invalid"]
        deadline = time.monotonic() + TIMEOUT
        while outcomes["invalid"] < began + 2000:
            assert time.monotonic() < deadline, "the stream of the frozen client makes no progress"
            session.put(f"graspforce/1/streams/{id}/state", bad)
        assert count_in_time(stream) == 100
        with client.open_stream(GRASP, validity=TIMEOUT) as another:
            assert count_in_time(another, 10) == 10
        client.query(f"streams/{id}", {"close": True})


def test_stream_of_a_dead_client_expires_and_a_paused_one_is_reopened():
    with (
        Server([HAND], listen=ANY_LOCAL_PORT, limits=ServerLimits(idle_timeout=0.3)) as server,
        Client(server.addresses[0], timeout=TIMEOUT) as client,
    ):
        command = [sys.executable, "-c", FLOOD, server.addresses[0], TESTS, "die"]
        ended = subprocess.run(command, stdout=subprocess.PIPE, check=False)
        assert ended.returncode == -signal.SIGKILL
        stream = client.open_stream(GRASP)
        stream.step(state(), desired())
        wait_until(lambda: streams(client) == 0)
        wait_until(lambda: not any(thread.name.startswith("stream-") for thread in threading.enumerate()))
        wait_until(lambda: not stream.step(state(), desired()).late)
        assert streams(client) == 1


def test_driver_without_close_ends(server):
    script = FLOOD.replace("while True", "for _ in range(20)") + "print('end')"
    command = [sys.executable, "-c", script, server.addresses[0], TESTS]
    done = subprocess.run(command, timeout=TIMEOUT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.splitlines()[1:]) == (0, ["end"]), done.stderr
