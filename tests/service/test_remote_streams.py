"""Control streams over real Zenoh: a server that is killed and returns, clients that flood, freeze or die, orderly ends."""

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
from support.control_requests import EXTERNAL, GRASP, HAND, SETTINGS, desired, request, sent, setup, state
from support.servers import ANY_LOCAL_PORT, PATIENCE, plain_session, python_process, server_process, suspend, wait_until

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController
from graspforce.core.errors import ErrorReply, InvalidInput, NoServer, RequestRefused, ServiceError
from graspforce.service import Client, Server, ServerLimits, StreamSetup, Watchdog
from graspforce.service.wire import protocol

TESTS = str(Path(__file__).parents[1])

# A driver of its own: says when its stream runs, then floods it with states, and reads no command.
FLOOD = """
import os, signal, sys
sys.path.insert(0, sys.argv[2])
from support.control_requests import GRASP, desired, state
from graspforce.service import Client
client = Client(sys.argv[1], timeout=20.0)
stream = client.open_stream(GRASP)
seen, wanted = state(), desired()
stream.step(seen, wanted)
print(stream.id, flush=True)
if "die" in sys.argv:
    os.kill(os.getpid(), signal.SIGKILL)
while True:
    stream.publish(seen, wanted)
"""

PERIOD = SETTINGS.period  # s


@pytest.fixture
def flooder(server):
    """A process that floods a stream of its own."""
    with python_process(FLOOD, server.addresses[0], TESTS) as flooding:
        yield flooding


def streams(client):
    return client.status().streams


# ── a stream ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("encoding", ["msgpack", "json"])
def test_a_stream_and_a_query_command_what_the_controller_here_does(server, encoding):
    controller = ObjectController(GRASP, SETTINGS)
    with Client(server.addresses[0], timeout=PATIENCE, encoding=encoding) as client:
        with client.open_stream(GRASP, SETTINGS, validity=PATIENCE) as stream:
            memory = None
            for i in range(10):
                command = controller.step(state(i), desired(), EXTERNAL)
                streamed = stream.step(state(i), desired(), EXTERNAL, wait=PATIENCE)
                asked = client.control(request(state=state(i), memory=memory))
                memory = asked.memory
                assert streamed.sequence == i + 1
                np.testing.assert_allclose(streamed.tau, command.tau, rtol=1e-9, atol=1e-12)
                # the query's solver starts cold: a cost known to 1e-8 knows the torques to about the root of that
                np.testing.assert_allclose(asked.tau, command.tau, rtol=0, atol=1e-4 * np.abs(command.tau).max())
                np.testing.assert_allclose(asked.acceleration, command.acceleration, rtol=1e-9)
                assert asked.solution.certificate.verified
            assert streams(client) == 1
        status = client.status()
        assert status.streams == 0
        assert status.counts[f"hands/{HAND.name}/control"]["ok"] >= 10
        assert status.counts["streams/*/state"]["ok"] >= 10


def test_anybody_can_stream_in_json(server):
    with plain_session(server.addresses[0]) as session:
        commands = session.declare_subscriber("graspforce/1/streams/mine/command", zenoh.handlers.RingChannel(1))
        record = json.dumps(protocol.decode(protocol.encode(setup().to_dict(), protocol.JSON), protocol.JSON))
        [reply] = session.get("graspforce/1/streams/mine", payload=record, timeout=PATIENCE)
        assert json.loads(reply.ok.payload.to_bytes())["opened"] is True
        session.put("graspforce/1/streams/mine/state", protocol.encode(sent(41).to_dict(), protocol.JSON))
        sample = commands.recv()
        command = json.loads(sample.payload.to_bytes())
        assert (str(sample.encoding), command["sequence"], len(command["torque"])) == (protocol.JSON, 41, HAND.n)
        session.put("graspforce/1/streams/mine/state", "{}")
        assert json.loads(commands.recv().payload.to_bytes())["error"] == "invalid"
        [reply] = session.get("graspforce/1/streams/mine", payload='{"close": true}', timeout=PATIENCE)
        assert json.loads(reply.ok.payload.to_bytes())["outcomes"] == {"ok": 1, "invalid": 1}
        assert list(session.get("graspforce/1/streams/*", payload=record, timeout=PATIENCE)) == []


def test_a_bad_opening_gets_the_text_that_python_gives_and_opens_nothing(client):
    before = streams(client)
    bad = {**setup().to_dict(), "validity": -1.0}
    with pytest.raises(InvalidInput) as caught:
        StreamSetup.from_dict({HAND.name: HAND}, bad)
    with pytest.raises(ErrorReply) as replied:
        client.query("streams/x", bad)
    assert (str(replied.value), replied.value.field) == (str(caught.value), "validity")
    assert streams(client) == before


def test_there_is_room_for_so_many():
    with (
        Server([HAND], listen=ANY_LOCAL_PORT, limits=ServerLimits(streams=1)) as server,
        Client(server.addresses[0], timeout=PATIENCE) as client,
    ):
        with client.open_stream(GRASP), pytest.raises(RequestRefused, match="1 streams are open"):
            client.open_stream(GRASP)
        client.open_stream(GRASP).step(state(), desired())


# ── the server goes, and comes back ────────────────────────────────────────────────────────────────────────────────────────


class Plant:
    """An object on a sinusoid of 10 mm at 1 Hz, a little behind where it should be; the hand as it was when it held it."""

    def __init__(self):
        self.start = time.monotonic()

    def now(self):
        """(state, desired) at this instant."""
        phase, reach, rate = 2.0 * np.pi * (time.monotonic() - self.start), 5e-3, 2.0 * np.pi  # rad, m, rad/s
        x, v, a = reach * np.sin(phase), reach * rate * np.cos(phase), -reach * rate**2 * np.sin(phase)
        along = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        wanted = BodyMotion(GRASP.p_HO + x * along[:3], GRASP.R_HO, v * along, a * along)
        behind = BodyMotion(GRASP.p_HO + (x - 1e-4) * along[:3], GRASP.R_HO, v * along)
        return GraspState(GRASP.q, np.zeros(HAND.n), behind), wanted


def test_a_server_that_is_killed_and_returns_costs_no_command_and_no_step_in_torque():
    """The watchdog commands for a second and more at full torque, relaxes, and the stream resumes by bounded steps."""
    dog = Watchdog(hold=1.0, ramp=0.5, floor=0.4, step=0.005)
    plant, commands = Plant(), []
    with server_process(HAND.name) as (first, address), Client(address, timeout=PATIENCE) as client:
        stream = client.open_stream(GRASP, ControlSettings(period=PERIOD), validity=0.1, watchdog=dog)

        def drive(is_met):
            """Run the driver's loop until something holds of its last command; returns how many commands it has had."""
            deadline = time.monotonic() + PATIENCE
            while not commands or not is_met(commands[-1]):
                assert time.monotonic() < deadline, "it never held"
                began = time.monotonic()
                commands.append(stream.step(*plant.now()))
                time.sleep(max(PERIOD - (time.monotonic() - began), 0.0))
            return len(commands)

        drive(lambda command: command.sequence > 200 and not command.late and not command.resuming)
        first.kill()
        first.wait(PATIENCE)
        held = drive(lambda command: command.age > dog.hold) - 1
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
    lost = np.flatnonzero(~late[:held])[-1]  # the last good command
    # it is held whole for a second, in which there is a command for every state
    assert commands[held - 1].age > 0.9 * dog.hold
    assert held - lost > 100
    np.testing.assert_allclose(taus[lost:held], np.tile(taus[lost], (held - lost, 1)), atol=1e-12)
    # then it relaxes to the floor of the ramp
    np.testing.assert_allclose(taus[relaxed - 1], dog.floor * taus[lost], atol=1e-12)
    # and until the server's commands are met again there is no step above the bound, though there is a way to go
    steps = np.abs(np.diff(taus[lost:resumed], axis=0))
    assert steps.max() <= dog.step * (1.0 + 1e-9)  # rounding
    assert np.abs(taus[relaxed - 1] - taus[resumed - 1]).max() > dog.step


def test_a_server_that_closes_in_order_closes_its_streams():
    with Server([HAND], listen=ANY_LOCAL_PORT) as server:
        client = Client(server.addresses[0], timeout=1.0)
        stream = client.open_stream(GRASP)
        stream.step(state(), desired())
        threads = [thread for thread in threading.enumerate() if thread.name == f"stream-{stream.id}"]
        assert len(threads) == 1
    with client:
        assert not threads[0].is_alive()
        wait_until(lambda: stream.step(state(), desired()).late and isinstance(stream.last_error, NoServer))


# ── clients that do not behave ─────────────────────────────────────────────────────────────────────────────────────────────


def in_time(stream, count=100):
    """How many of so many steps get their own command."""
    return sum(stream.step(state(i), desired(), wait=PATIENCE).sequence == stream.sequence for i in range(count))


def test_a_flood_stops_nobody_and_only_its_newest_states_are_looked_at(client, flooder):
    child, id = flooder
    with client.open_stream(GRASP, validity=PATIENCE) as stream:
        assert in_time(stream) == 100
        assert client.control(request()).solution.found
        child.kill()
        child.wait(PATIENCE)
        told = client.query(f"streams/{id}", {"close": True})
        assert told["outcomes"]["ok"] > 0
        assert told["skipped"] > 0


def test_a_client_that_freezes_over_its_commands_stops_nobody(server, client, flooder):
    """Answers of 8 kB that nobody reads, 16 MB of them and more, are more than sockets and queues hold."""
    child, id = flooder
    with client.open_stream(GRASP, validity=PATIENCE) as stream, plain_session(server.addresses[0]) as session:
        suspend(child)
        outcomes, bad = server._handler.streams[id].outcomes, json.dumps({"x" * 4000: 1})
        began = outcomes["invalid"]
        deadline = time.monotonic() + PATIENCE
        while outcomes["invalid"] < began + 2000:
            assert time.monotonic() < deadline, "the stream of the frozen client stands still"
            session.put(f"graspforce/1/streams/{id}/state", bad)
        assert in_time(stream) == 100
        with client.open_stream(GRASP, validity=PATIENCE) as another:
            assert in_time(another, 10) == 10
        client.query(f"streams/{id}", {"close": True})


def test_a_dead_clients_stream_expires_and_one_that_pauses_is_opened_again():
    with (
        Server([HAND], listen=ANY_LOCAL_PORT, limits=ServerLimits(idle_timeout=0.3)) as server,
        Client(server.addresses[0], timeout=PATIENCE) as client,
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


def test_a_driver_that_forgets_to_close_ends(server):
    script = FLOOD.replace("while True", "for _ in range(20)") + "print('end')"
    command = [sys.executable, "-c", script, server.addresses[0], TESTS]
    done = subprocess.run(command, timeout=PATIENCE, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.splitlines()[1:]) == (0, ["end"]), done.stderr
