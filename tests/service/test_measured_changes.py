"""Changes of contacts in a stream of measurements: as with a local controller, continuous, and continued after a restart."""

from __future__ import annotations

import itertools
import time
from dataclasses import replace

import msgspec
import numpy as np
from support.control_requests import CODECS, GRASP, HAND, HANDS, SETTINGS, setup
from support.local_server import LocalServer

from graspforce.contact.matrices import grasp_matrix
from graspforce.contact.motion import BodyMotion
from graspforce.control import ContactChange, OutputFeedbackController
from graspforce.estimation import Measurement
from graspforce.estimation.sensor_model import SensorModel
from graspforce.service import Stream, StreamSetup, StreamState, Watchdog
from graspforce.service.client.command_stream import StreamLink
from graspforce.service.client.stream_changes import resumed_setup
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.change_records import NumberedChange
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.wire.protocol import JSON, MSGPACK

FINGER = GRASP.fingers[1]
RATE = 10.0  # N/s: 0.02 N a period, at a lever of at most 0.12 m; twice that, and the noise of 0.003 N·m, stay below 0.01 N·m
RELEASE = ContactChange(release=[FINGER], force_rate=RATE)
JOIN = ContactChange(add={FINGER: GRASP.contacts.contacts[1]}, force_rate=RATE)
SENSORS = SensorModel()
NOISE = 2e-6  # rad, in the measured postures
TARGET = BodyMotion(GRASP.p_HO, GRASP.R_HO)
TIMEOUT = 20.0  # s, only a failing test waits so long
MOST_STEPS = 3000
DOG = Watchdog()


def measurement(sequence: int) -> Measurement:
    """Return the measurement of a posture at rest, with noise that depends on its number."""
    noise = NOISE * np.random.default_rng(sequence).standard_normal(HAND.n)
    return Measurement(sequence * SETTINGS.period, GRASP.q + noise)


class Driver:
    """Sends measurements at rest to a server's stream, and reads the commands."""

    def __init__(self, stream_setup: StreamSetup, codec: str = MSGPACK, sequence: int = 0) -> None:
        self.stream, self.codec, self.sequence = ServerStream("a", stream_setup), codec, sequence
        decoder = msgspec.json.Decoder if codec == JSON else msgspec.msgpack.Decoder
        self._read = decoder(CommandRecord).decode

    def send(self, change: NumberedChange | None = None) -> CommandRecord:
        self.sequence += 1
        state = StreamState(self.sequence, 12.25, measurement(self.sequence), TARGET, contacts=change)
        reply = self.stream.command(state.encode(self.codec), self.codec)
        assert reply.ok, reply.payload
        return self._read(reply.payload)

    def send_until_begun(self, change: NumberedChange) -> list[CommandRecord]:
        """Repeat a change until a command acknowledges it, and return the commands."""
        deadline, commands = time.monotonic() + TIMEOUT, []
        while time.monotonic() < deadline:
            commands.append(self.send(change))
            record = commands[-1].contact_change
            if record is not None and record.number == change.number:
                return commands
        raise AssertionError("the change has not begun")

    def send_until_over(self) -> list[CommandRecord]:
        """Return the commands until no contact changes any more."""
        commands = []
        while len(commands) < MOST_STEPS:
            commands.append(self.send())
            if not commands[-1].contact_change.changing:
                return commands
        raise AssertionError("the change does not end")


@CODECS
def test_server_changes_contacts_like_a_local_controller(codec):
    driver, controller = Driver(setup(memory=None, sensors=SENSORS), codec), OutputFeedbackController(GRASP, SETTINGS, SENSORS)

    def compare(records: list[CommandRecord], first: int) -> None:
        for sequence, record in enumerate(records, start=first):
            grasp = controller.grasp
            command = controller.step(measurement(sequence), TARGET)
            if record.contact_change is not None:
                assert record.contact_change.fingers == grasp.fingers
            remote = record.unpack(grasp)
            # torques are accurate to the square root of the tolerance of the cost, 1e-8
            np.testing.assert_allclose(remote.tau, command.tau, atol=1e-4 * np.abs(command.tau).max())
            np.testing.assert_allclose(record.estimate.position, controller.estimate.object.p_HO, atol=1e-9)

    compare([driver.send() for _ in range(5)], 1)
    for number, change in ((1, RELEASE), (2, JOIN)):
        first = driver.sequence + 1
        waiting = driver.send_until_begun(NumberedChange(number, change))
        compare(waiting[:-1], first)
        controller.change_contacts(change)
        compare([waiting[-1], *driver.send_until_over()], first + len(waiting) - 1)
    assert controller.grasp.fingers == (*(name for name in GRASP.fingers if name != FINGER), FINGER)


def test_torques_and_estimates_do_not_jump():
    """Through release and return: torques within the watchdog's bound, estimates within the noise of the encoders."""
    driver = Driver(setup(memory=None, sensors=SENSORS))
    records = [driver.send() for _ in range(20)]
    for number, change in ((1, RELEASE), (2, JOIN)):
        records += [*driver.send_until_begun(NumberedChange(number, change)), *driver.send_until_over()]
    torques = np.array([np.frombuffer(each.torque) if isinstance(each.torque, bytes) else each.torque for each in records])
    assert np.abs(np.diff(torques, axis=0)).max() <= DOG.step
    assert not any("torque step limited" in warning for each in records for warning in each.warnings)
    places = np.array([each.estimate.position for each in records])
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 2e-6  # m: 2 µrad is about 0.2 µm at a fingertip
    assert {len(each.slip_margin) for each in records} == {3, 4}


def test_change_in_the_first_state_begins_after_its_step():
    driver = Driver(setup(memory=None, sensors=SENSORS))
    first = driver.send(NumberedChange(1, RELEASE))
    assert first.contact_change.number == 0
    driver.send_until_begun(NumberedChange(1, RELEASE))
    assert FINGER not in driver.send_until_over()[-1].contact_change.fingers


def test_refused_change_names_its_field_and_the_stream_goes_on():
    driver = Driver(setup(memory=None, sensors=SENSORS))
    driver.send()
    driver.sequence += 1
    state = StreamState(driver.sequence, 12.25, measurement(driver.sequence), TARGET, contacts=NumberedChange(1, JOIN))
    reply = driver.stream.command(state.encode(JSON), JSON)
    assert not reply.ok
    assert protocol.decode(reply.payload, JSON)["field"] == "contacts.add[0].finger"
    assert driver.send().contact_change.refused == 1


def test_restart_in_the_middle_of_a_change_continues_it():
    """Open again with memory and estimate of a command in the ramp: the change ends, and no torque jumps."""
    original = setup(memory=None, sensors=SENSORS)
    driver, grasp = Driver(original), GRASP
    driver.send()
    last = driver.send_until_begun(NumberedChange(1, RELEASE))[-1]
    for _ in range(5):
        last = driver.send()
    assert last.contact_change.changing
    resumed = resumed_setup(original, last.unpack(grasp))
    assert resumed.change_number == 1
    again = StreamSetup.from_dict(HANDS, protocol.decode(protocol.encode(resumed.to_dict(), MSGPACK), MSGPACK))
    driver = Driver(again, sequence=driver.sequence)
    rest = driver.send_until_over()
    torques = np.array([each.torque for each in (last, *rest)])
    assert np.abs(np.diff(torques, axis=0)).max() <= DOG.step
    assert FINGER not in rest[-1].contact_change.fingers


def test_client_changes_contacts_with_small_torque_steps():
    server, counter = LocalServer(), itertools.count(1)
    options = {"watchdog": DOG, "codec": MSGPACK, "timeout": TIMEOUT, "query": server.query, "connect": server.connect}
    stream = Stream("a", setup(memory=None, validity=TIMEOUT, sensors=SENSORS), StreamLink(**options))
    try:
        commands = [stream.step(measurement(next(counter)), TARGET, wait=TIMEOUT)]
        for change in (RELEASE, JOIN):
            stream.change_contacts(change)
            deadline = time.monotonic() + TIMEOUT
            while stream.is_changing:
                assert time.monotonic() < deadline
                commands.append(stream.step(measurement(next(counter)), TARGET, wait=TIMEOUT))
            assert (FINGER in stream.grasp.fingers) == (change is JOIN)
        assert stream.change_error is None
        assert stream.grasp.fingers[-1] == FINGER
        estimate = commands[-1].estimate
        assert np.linalg.norm(stream.grasp.p_HO - estimate.position) < 1e-4  # m
        assert np.abs(np.diff([command.tau for command in commands], axis=0)).max() <= DOG.step
        assert all(len(command.slip_margin) == len(command.grasp.fingers) for command in commands)
    finally:
        stream.close()


def test_forces_balance_the_wrench_in_every_step_of_a_release():
    """G f = w, with the present contacts of each command."""
    driver = Driver(setup(memory=None, sensors=SENSORS))
    driver.send()
    records = [*driver.send_until_begun(NumberedChange(1, RELEASE)), *driver.send_until_over()]
    rest = [name for name in GRASP.fingers if name != FINGER]
    without = replace(GRASP, fingers=rest, contacts=GRASP.contacts.select([GRASP.fingers.index(name) for name in rest]))
    counts = set()
    for record in records:
        is_whole = len(record.slip_margin) == len(GRASP.fingers)
        contacts = record.unpack(GRASP if is_whole else without).contacts
        np.testing.assert_allclose(grasp_matrix(contacts) @ np.asarray(record.force), record.wrench, atol=1e-4)
        counts.add(len(contacts))
    assert 4 in counts
