"""Changes of contacts in a running stream: begun once, continuous, acknowledged, and continued after a restart."""

from __future__ import annotations

import itertools
import time
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from support.control_requests import CODECS, GRASP, HAND, HANDS, SETTINGS, setup, to_binary
from support.local_server import LocalServer

from graspforce.contact.motion import BodyMotion
from graspforce.control import ContactChange, ContactConditions, GraspState, ObjectController
from graspforce.core.errors import ErrorReply, InvalidInput, UnknownName
from graspforce.service import Stream, StreamSetup, StreamState, Watchdog
from graspforce.service.client.command_stream import StreamLink
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.change_records import NumberedChange
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.wire.control_records import ControlRequest
from graspforce.service.wire.protocol import JSON, MSGPACK

FINGER = GRASP.fingers[1]
RATE = 60.0  # N/s
RELEASE = ContactChange(release=[FINGER], force_rate=RATE)
JOIN = ContactChange(add={FINGER: GRASP.contacts.contacts[1]}, force_rate=RATE)
REST = GraspState(GRASP.q, np.zeros(HAND.n), BodyMotion(GRASP.p_HO, GRASP.R_HO))
TARGET = BodyMotion(GRASP.p_HO, GRASP.R_HO)
TIMEOUT = 20.0  # s, only a failing test waits so long
MOST_STEPS = 3000
DOG = Watchdog()


def rest_state(sequence: int, change: NumberedChange | None = None, **fields) -> StreamState:
    return StreamState(sequence, 12.25, REST, TARGET, contacts=change, **fields)


class Driver:
    """Sends states at rest to a server's stream, and reads the commands."""

    def __init__(self, stream_setup: StreamSetup, codec: str = MSGPACK) -> None:
        self.stream, self.codec, self.sequence = ServerStream("a", stream_setup), codec, 0
        decoder = msgspec.json.Decoder if codec == JSON else msgspec.msgpack.Decoder
        self._read = decoder(CommandRecord).decode

    def send(self, change: NumberedChange | None = None, **fields) -> CommandRecord:
        self.sequence += 1
        reply = self.stream.command(rest_state(self.sequence, change, **fields).encode(self.codec), self.codec)
        assert reply.ok, reply.payload
        return self._read(reply.payload)

    def refusal(self, record: dict, codec: str = JSON) -> dict:
        """Return the error record in reply to a state with other fields."""
        self.sequence += 1
        payload = protocol.encode({**rest_state(self.sequence).to_dict(), **record}, codec)
        reply = self.stream.command(payload, codec)
        assert not reply.ok
        return protocol.decode(reply.payload, codec)

    def send_until_begun(self, change: NumberedChange) -> CommandRecord:
        """Repeat a change until a command acknowledges it. The server prepares the change in another thread."""
        deadline = time.monotonic() + TIMEOUT
        while time.monotonic() < deadline:
            record = self.send(change)
            if record.contact_change.number == change.number:
                return record
        raise AssertionError("the change has not begun")

    def send_until_over(self) -> list[CommandRecord]:
        """Return the commands until no contact changes any more."""
        commands = []
        while len(commands) < MOST_STEPS:
            commands.append(self.send())
            if not commands[-1].contact_change.changing:
                return commands
        raise AssertionError("the change does not end")


@pytest.fixture
def server():
    return LocalServer()


@pytest.fixture
def open_stream(server):
    """Return a function that opens a stream; the streams are closed at the end."""
    opened = []

    def start(**change) -> Stream:
        watchdog = change.pop("watchdog", DOG)
        options = {"watchdog": watchdog, "codec": MSGPACK, "timeout": TIMEOUT, "query": server.query, "connect": server.connect}
        opened.append(Stream("a", setup(**{"memory": None, "validity": TIMEOUT, **change}), StreamLink(**options)))
        return opened[-1]

    yield start
    for stream in opened:
        stream.close()


def steps_until(stream: Stream, is_met) -> list:
    """Return the commands of steps at rest until a condition is met."""
    commands, deadline = [], time.monotonic() + TIMEOUT
    while not is_met():
        assert time.monotonic() < deadline, "the condition was not met in time"
        commands.append(stream.step(REST, TARGET, wait=TIMEOUT))
    return commands


# ── records ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


@CODECS
def test_change_and_named_conditions_are_read_back(codec):
    change = NumberedChange(3, ContactChange([FINGER], {"finger_1": GRASP.contacts.contacts[0]}, RATE))
    conditions = ContactConditions(slipping=[True, False, False, True])
    state = rest_state(1, change, conditions=conditions, fingers=GRASP.fingers)
    for payload in (state.encode(codec), protocol.encode(state.to_dict(), codec)):
        read = StreamState.decode(HAND, payload, codec)
        assert read.contacts.to_dict() == change.to_dict()
        assert read.conditions.to_dict() == conditions.to_dict()
        assert read.fingers == GRASP.fingers
    assert "contacts" not in rest_state(1).to_dict()


def test_arrays_of_contacts_may_be_binary():
    change = NumberedChange(1, JOIN).to_dict()
    record = {**rest_state(1).to_dict(), "contacts": change}
    binary = {**change, "add": [{**item, **to_binary({k: item[k] for k in ("position", "normal")})} for item in change["add"]]}
    read = StreamState.from_dict(HAND, {**record, "contacts": binary})
    np.testing.assert_array_equal(read.contacts.change.add[FINGER].position, GRASP.contacts.contacts[1].position)


BAD_CHANGES = [
    ({"release": [FINGER]}, "contacts.number"),
    ({"number": 0, "release": [FINGER]}, "contacts.number"),
    ({"number": 1.5, "release": [FINGER]}, "contacts.number"),
    ({"number": 1}, "contacts.release"),
    ({"number": 1, "release": ["thumb"]}, "contacts.release[0]"),
    ({"number": 1, "release": [FINGER, FINGER]}, "contacts.release"),
    ({"number": 1, "release": list(GRASP.fingers)}, "contacts.release"),
    ({"number": 1, "release": [FINGER], "force_rate": 0.0}, "contacts.force_rate"),
    ({"number": 1, "let_go": [FINGER]}, "contacts.let_go"),
    ({"number": 1, "add": [{**GRASP.contacts.contacts[0].to_dict(), "finger": "thumb"}]}, "contacts.add[0].finger"),
    ({"number": 1, "add": [{**GRASP.contacts.contacts[0].to_dict(), "finger": FINGER}]}, "contacts.add[0].finger"),
    ({"number": 1, "add": [{"finger": FINGER}]}, "contacts.add[0].position"),
    ([FINGER], "contacts"),
]


@CODECS
@pytest.mark.parametrize(("record", "field"), BAD_CHANGES)
def test_invalid_change_is_refused_by_field_and_the_stream_goes_on(codec, record, field):
    driver = Driver(setup(memory=None))
    before = driver.send()
    error = driver.refusal({"contacts": record}, codec)
    assert (error["field"], error["sequence"]) == (field, driver.sequence)
    assert error["error"] in {"invalid", "unknown"}
    after = driver.send()
    np.testing.assert_allclose(np.frombuffer(after.torque), np.frombuffer(before.torque), atol=1e-3)


def test_refused_number_costs_one_command_only():
    """A client that repeats it gets commands again, which state the refusal."""
    driver = Driver(setup(memory=None))
    record = {"contacts": {"number": 1, "release": ["thumb"]}}
    assert driver.refusal(record)["field"] == "contacts.release[0]"
    again = driver.send(NumberedChange(1, ContactChange(release=["thumb"])))
    assert (again.contact_change.number, again.contact_change.refused) == (0, 1)
    driver.send_until_begun(NumberedChange(2, RELEASE))
    error = driver.refusal({"contacts": {"number": 3, "release": [GRASP.fingers[0]]}})
    assert "in progress" in error["message"]
    assert driver.send().contact_change.refused == 3


# ── the server ────────────────────────────────────────────────────────────────────────────────────────────────────────────


@CODECS
def test_server_changes_contacts_like_a_local_controller(codec):
    """The change begins with the state whose command acknowledges it; release and return give the local torques."""
    driver, controller = Driver(setup(memory=None), codec), ObjectController(GRASP, SETTINGS)
    driver.send()
    controller.step(REST, TARGET)
    for number, change in ((1, RELEASE), (2, JOIN)):
        sent, begun = driver.sequence, driver.send_until_begun(NumberedChange(number, change))
        for _ in range(driver.sequence - sent - 1):
            controller.step(REST, TARGET)
        controller.change_contacts(change, REST)
        for record in [begun, *driver.send_until_over()]:
            grasp, is_changing = controller.grasp, controller.is_changing
            command = controller.step(REST, TARGET)
            remote, fingers = record.unpack(grasp), grasp.fingers
            assert record.contact_change.fingers == fingers
            assert record.contact_change.changing == (controller.is_changing or controller.grasp.fingers != fingers)
            assert is_changing or not record.contact_change.changing
            # torques are accurate to the square root of the tolerance of the cost, 1e-8
            np.testing.assert_allclose(remote.tau, command.tau, atol=1e-4 * np.abs(command.tau).max())
    assert controller.grasp.fingers == (*(name for name in GRASP.fingers if name != FINGER), FINGER)


def test_repeated_change_begins_once():
    """A repeated or smaller number is ignored, also after the end of its change."""
    driver = Driver(setup(memory=None))
    driver.send_until_begun(NumberedChange(4, RELEASE))
    limits = [driver.send(NumberedChange(4, RELEASE)).memory.ramp["limit"][1] for _ in range(20)]
    assert all(later is None or later < earlier for earlier, later in itertools.pairwise(limits))
    over = driver.send_until_over()[-1]
    again = driver.send(NumberedChange(4, JOIN))
    older = driver.send(NumberedChange(3, JOIN))
    for record in (over, again, older):
        assert (record.contact_change.number, record.contact_change.changing) == (4, False)
        assert FINGER not in record.contact_change.fingers


def test_change_begins_if_its_state_is_the_only_one_that_carries_it():
    driver = Driver(setup(memory=None))
    driver.send(NumberedChange(1, RELEASE))
    deadline = time.monotonic() + TIMEOUT
    while driver.send().contact_change.number < 1:
        assert time.monotonic() < deadline
    assert FINGER not in driver.send_until_over()[-1].contact_change.fingers


def test_commands_without_a_change_have_no_record_of_it():
    reply = ServerStream("a", setup(memory=None)).command(rest_state(1).encode(JSON), JSON)
    assert "contact_change" not in protocol.decode(reply.payload, JSON)


@CODECS
def test_restart_in_the_middle_of_a_change_continues_it(codec):
    """Open again with the memory of each tenth command: the torques are those of a stream that was not interrupted."""
    steady, restarted = Driver(setup(memory=None), codec), Driver(setup(memory=None), codec)
    for driver in (steady, restarted):
        driver.send_until_begun(NumberedChange(1, RELEASE))
    for count in range(MOST_STEPS):
        record, other = steady.send(), restarted.send()
        assert other.contact_change == record.contact_change
        if not record.contact_change.changing:
            break
        one, two = (each.unpack(GRASP) for each in (record, other))
        np.testing.assert_allclose(two.tau, one.tau, atol=2e-3 * np.abs(one.tau).max())  # cold starts add up in the ramp
        if count % 10 == 9:
            again = setup(memory=two.memory, change_number=1)
            decoded = protocol.decode(protocol.encode(again.to_dict(), codec), codec)
            restarted = Driver(StreamSetup.from_dict(HANDS, decoded), codec)
    assert count > 20
    assert FINGER not in record.contact_change.fingers


def test_conditions_name_their_fingers_across_a_change():
    """Conditions in the order of named fingers hold for the present contacts; without names the number must fit."""
    driver = Driver(setup(memory=None))
    driver.send_until_begun(NumberedChange(1, RELEASE))
    driver.send_until_over()
    slipping = ContactConditions(slipping=[False, False, False, True])
    named = driver.send(conditions=slipping, fingers=GRASP.fingers)
    assert named.memory.reflex["slipping"] == [False, False, True]
    assert driver.refusal({"conditions": slipping.to_dict()})["field"].endswith("slipping")
    bad = {**slipping.to_dict(), "fingers": list(GRASP.fingers[:2])}
    assert driver.refusal({"conditions": bad})["field"] == "conditions.slipping"


# ── the client ────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_stream_changes_contacts_with_small_torque_steps(open_stream):
    """Release and return: the grasp follows the commands, and no torque changes by more than the watchdog's bound."""
    stream = open_stream()
    commands = [stream.step(REST, TARGET, wait=TIMEOUT)]
    for change in (RELEASE, JOIN):
        stream.change_contacts(replace(change, force_rate=20.0))
        assert stream.is_changing
        commands += steps_until(stream, lambda: not stream.is_changing)
        assert (FINGER in stream.grasp.fingers) == (change is JOIN)
    assert stream.grasp.fingers[-1] == FINGER
    assert stream.change_error is None
    np.testing.assert_allclose(stream.grasp.contacts.mu, GRASP.contacts.mu)
    np.testing.assert_allclose(stream.grasp.contacts.p_OC[-1], GRASP.contacts.p_OC[1], atol=1e-5)
    assert np.abs(np.diff([command.tau for command in commands], axis=0)).max() <= DOG.step
    assert all(len(command.slip_margin) == len(command.grasp.fingers) for command in commands)


def test_change_is_repeated_until_it_is_acknowledged(open_stream, server):
    """States and commands get lost: the change begins once anyway."""
    stream = open_stream()
    stream.step(REST, TARGET, wait=TIMEOUT)
    stream.change_contacts(RELEASE)
    server.silent = True
    for _ in range(3):
        stream.publish(REST, TARGET)
    states = [StreamState.decode(HAND, payload, MSGPACK) for payload in server.payloads]
    assert [each.contacts is not None for each in states] == [False, True, True, True]
    assert {each.contacts.number for each in states[1:]} == {1}
    server.silent = False
    while stream.is_changing and FINGER in stream.grasp.fingers:
        stream.publish(REST, TARGET)
        if stream.sequence % 3:
            server.box.clear()  # two of three commands get lost
        stream.latest()
        assert stream.sequence < MOST_STEPS
    steps_until(stream, lambda: not stream.is_changing)
    assert FINGER not in stream.grasp.fingers
    assert StreamState.decode(HAND, server.payloads[-1], MSGPACK).contacts is None


def test_stream_refuses_impossible_changes_before_it_sends_them(open_stream, server):
    stream = open_stream()
    with pytest.raises(UnknownName, match="thumb"):
        stream.change_contacts(ContactChange(release=["thumb"]))
    with pytest.raises(InvalidInput, match="must let go first"):
        stream.change_contacts(JOIN)
    stream.change_contacts(RELEASE)
    with pytest.raises(InvalidInput, match="in progress"):
        stream.change_contacts(ContactChange(release=[GRASP.fingers[0]]))


@pytest.mark.parametrize("is_error_lost", [False, True])
def test_refusal_of_the_server_ends_the_change(open_stream, server, is_error_lost):
    stream = open_stream()
    good = stream.step(REST, TARGET, wait=TIMEOUT)
    stream.change_contacts(RELEASE)
    stream._changes.pending = NumberedChange(1, ContactChange(release=["thumb"]))  # a change that only the server refuses
    stream.publish(REST, TARGET)
    if is_error_lost:
        server.box.clear()
        stream.publish(REST, TARGET)
    command = stream.latest()
    np.testing.assert_allclose(command.tau, good.tau, atol=1e-3)
    assert not stream.is_changing
    assert isinstance(stream.change_error, ErrorReply)
    stream.change_contacts(RELEASE)
    assert stream.change_error is None
    steps_until(stream, lambda: not stream.is_changing)
    assert FINGER not in stream.grasp.fingers


@pytest.mark.parametrize("keeps_memory", [True, False])
def test_stream_resumes_with_the_present_grasp_after_a_restart(open_stream, server, keeps_memory):
    stream = open_stream(validity=0.05, watchdog=Watchdog(hold=TIMEOUT))  # a test that is held up does not ramp down

    def steps_until_settled(is_met):
        """Return the first command in time, not resuming, that meets a condition."""
        deadline = time.monotonic() + TIMEOUT
        while True:
            assert time.monotonic() < deadline, "the condition was not met in time"
            command = stream.step(REST, TARGET)
            if is_met(command) and not command.late and not command.resuming:
                return command

    stream.step(REST, TARGET)
    stream.change_contacts(RELEASE)
    before = steps_until_settled(lambda command: not stream.is_changing and len(command.slip_margin) == 3)
    server.streams.close()
    answer = server.streams.answer

    def reject_memory(id, record):
        if "memory" in record and not keeps_memory:
            raise ErrorReply("invalid", "memory = 3: must be another", "memory")
        return answer(id, record)

    server.streams.answer = reject_memory
    command = steps_until_settled(lambda command: command.sequence > before.sequence)
    assert server.asked[-1]["change_number"] == 1
    assert command.contact_change.fingers == stream.grasp.fingers == before.contact_change.fingers
    np.testing.assert_allclose(command.tau, before.tau, atol=2e-3)
    stream.change_contacts(JOIN)
    steps_until_settled(lambda command: not stream.is_changing)
    assert stream.grasp.fingers[-1] == FINGER


def test_unchanged_stream_that_opens_again_keeps_its_changed_contacts(open_stream, server):
    """A client that lost the connection, not the server, opens its stream again: the server's stream goes on."""
    stream = open_stream()
    stream.step(REST, TARGET, wait=TIMEOUT)
    stream.change_contacts(RELEASE)
    steps_until(stream, lambda: not stream.is_changing)
    command = stream.latest()
    again = setup(validity=TIMEOUT, memory=command.memory, change_number=1).to_dict()
    again["hold"] = stream.grasp.to_dict()
    assert server.query(again)["opened"] is False
    assert stream.step(REST, TARGET, wait=TIMEOUT).contact_change.fingers == stream.grasp.fingers


def test_requests_of_one_step_have_no_changes():
    record = {**ControlRequest(GRASP, REST, TARGET).to_dict(), "contacts": NumberedChange(1, RELEASE).to_dict()}
    with pytest.raises(InvalidInput, match="contacts"):
        ControlRequest.from_dict(HAND, record)
