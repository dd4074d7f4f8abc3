"""Recordings of servers: what is in the file, what is dropped, and replays that are equal to the bit."""

from __future__ import annotations

import json
import sys
import warnings
from pathlib import Path

import msgspec
import numpy as np
import pytest
from support.control_requests import GRASP, HAND, HANDS, SETTINGS, desired_with_joints, state
from support.servers import ANY_LOCAL_PORT, TIMEOUT, wait_until
from support.service_requests import infeasible_pinch, pinch

from graspforce.cli import main
from graspforce.cli.console import ERROR, SUCCESS
from graspforce.contact.motion import BodyMotion
from graspforce.control import ContactChange, GraspState
from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.joints.joint_controller import JointController
from graspforce.core.errors import ErrorReply, InvalidInput
from graspforce.service import Client, JointStreamSetup, Server, StreamState, Watchdog
from graspforce.service.recording.exchange import END, REQUEST, STATE, Exchange, Header, this_machine, this_version
from graspforce.service.recording.recorder import Recorder, RecorderOptions
from graspforce.service.recording.recording_reader import ServerRecording
from graspforce.service.recording.recording_writer import RecordingWriter
from graspforce.service.replay.held_changes import HeldChanges
from graspforce.service.replay.replay import Replay, load_hands
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.change_records import NumberedChange
from graspforce.service.wire.stream_setups import read_setup

pytest.importorskip("foxglove")
reader_module = pytest.importorskip("mcap.reader")
decoder_module = pytest.importorskip("mcap_protobuf.decoder")

STEPS = 40
REST = GraspState(GRASP.q, np.zeros(HAND.n), BodyMotion(GRASP.p_HO, GRASP.R_HO))
TARGET = BodyMotion(GRASP.p_HO, GRASP.R_HO)
FOXGLOVE = {
    "pose": "PoseInFrame",
    "desired": "PoseInFrame",
    "joint_states": "JointStates",
    "forces": "SceneUpdate",
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> ServerRecording:
    """Return the recording of requests, a stream whose contacts change, and a stream of joints."""
    path = tmp_path_factory.mktemp("recording") / "day.mcap"
    with Server(["four_finger"], listen=ANY_LOCAL_PORT, record=path) as server, Client(server.addresses[0]) as client:
        for request in (pinch(), infeasible_pinch()):
            client.query("solve", request)
        with pytest.raises(ErrorReply):
            client.query("solve", pinch(wrench=3))
        client.status()
        client.forward("four_finger", HAND.neutral)
        with client.open_stream(GRASP, SETTINGS, validity=TIMEOUT, watchdog=Watchdog()) as stream:
            for seed in range(STEPS):
                stream.step(state(seed), desired_with_joints(), wait=TIMEOUT)
            stream.change_contacts(ContactChange(release=[GRASP.fingers[1]], force_rate=200.0))
            stream.step(REST, TARGET, wait=TIMEOUT)
            wait_until(lambda: stream.step(REST, TARGET, wait=TIMEOUT) is not None and not stream.is_changing)
        law = JointController.with_frequency(HAND, "computed_torque", 3.0, SETTINGS.gravity_H)
        with client.open_joint_stream(JointStreamSetup(law, SETTINGS.period, validity=TIMEOUT)) as joints:
            joints.step(JointMotion(HAND.neutral), JointMotion(HAND.neutral + 0.1), wait=TIMEOUT)
    server._recorder.wait()
    return ServerRecording.open(path)


def rewrite(recording: ServerRecording, path: Path, exchanges: list[Exchange]) -> ServerRecording:
    """Write other exchanges of the same server, and return their recording."""
    header = Header(recording.clock, this_version(), this_machine(), recording.hands, recording.limits)
    with path.open("wb") as file, RecordingWriter(file, header) as writer:
        for each in exchanges:
            writer.write(each)
    return ServerRecording.open(path)


def control_states(recording: ServerRecording) -> list[Exchange]:
    """Return the states of the stream that holds an object."""
    states = [each for each in recording.exchanges() if each.kind == STATE]
    return [each for each in states if each.key == states[0].key]


def test_a_replay_is_equal_to_the_bit(recorded):
    report = Replay(recorded, HANDS).run()
    assert report.is_equal, [each.examples for each in report.sources.values()]
    assert report.notes == ()
    stream = control_states(recorded)[0].source
    result = report.sources[stream]
    assert result.equal == result.count > STEPS
    assert report.sources["requests/solve"].equal == 3
    assert sum(each.equal for name, each in report.sources.items() if name.startswith("streams/")) == result.count + 1
    changed = [protocol.decode(each.reply, each.reply_encoding).get("contact_change") for each in control_states(recorded)]
    assert 1 in {each["number"] for each in changed if each}


def test_the_library_mcap_reads_every_message_with_its_schema(recorded):
    with warnings.catch_warnings(), recorded.path.open("rb") as file:
        warnings.simplefilter("error")
        reader = reader_module.make_reader(file, validate_crcs=True)
        names, found = {}, set()
        for schema, channel, message in reader.iter_messages():
            if channel.message_encoding == "protobuf":
                decoder_module.DecoderFactory().decoder_for("protobuf", schema)(message.data)
                found.add((channel.topic.rpartition("/")[2], schema.name))
            else:
                protocol.decode(message.data, channel.metadata["encoding"]) if message.data else None
                names[channel.topic.split("/")[1], schema.name] = json.loads(schema.data)
    assert {("replies", "graspforce/solve/reply"), ("errors", "graspforce/error")} <= set(names)
    assert {("streams", "graspforce/streams/state"), ("streams", "graspforce/streams/command")} <= set(names)
    assert all(each["$schema"].startswith("https://json-schema.org/") for each in names.values())
    assert found == {*((topic, f"foxglove.{name}") for topic, name in FOXGLOVE.items()), ("tf", "foxglove.FrameTransforms")}


def test_keys_of_streams_are_not_written(recorded):
    openings = [each for each in recorded.exchanges() if each.kind == REQUEST and each.key.startswith("streams/")]
    opened = [protocol.decode(each.reply, each.reply_encoding) for each in openings]
    assert sum(each.get("opened") is True for each in opened) == 2
    assert not any("key" in each for each in opened)
    assert not any("proof" in protocol.decode(each.payload, each.encoding) for each in openings)


def test_a_changed_number_is_found_and_named(recorded, tmp_path, capsys):
    exchanges = list(recorded.exchanges())
    place = [i for i, each in enumerate(exchanges) if each.kind == STATE][5]
    record = protocol.decode(exchanges[place].reply, protocol.MSGPACK)
    torque = np.frombuffer(record["torque"]).copy()
    torque[2] = np.nextafter(torque[2], np.inf)
    record["torque"] = torque.tobytes()
    exchanges[place].reply = protocol.encode(record, protocol.MSGPACK)
    changed = rewrite(recorded, tmp_path / "changed.mcap", exchanges)
    report = Replay(changed, HANDS).run()
    assert not report.is_equal
    ((number, difference),) = report.sources[exchanges[place].source].examples
    assert (number, difference.path) == (5, "torque")
    assert 0.0 < difference.size < 1e-15
    assert main(["replay", str(changed.path)]) == ERROR
    assert "replies differ" in capsys.readouterr().out
    assert main(["replay", str(recorded.path), "--json"]) == SUCCESS
    assert json.loads(capsys.readouterr().out)["equal"] is True


def test_states_after_a_gap_are_not_compared(recorded, tmp_path):
    states = control_states(recorded)
    stream = f"streams/{states[0].key}"
    opening = next(each for each in recorded.exchanges() if each.kind == REQUEST and each.key == stream)
    states[12].dropped = 2
    result = Replay(rewrite(recorded, tmp_path / "gap.mcap", [opening, *states[:10], *states[12:20]]), HANDS).run()
    assert result.sources[states[0].source].equal == 10
    assert dict(result.sources[states[0].source].explained) == {"after dropped states": 8}
    assert any("no end" in note for note in result.notes)


def test_a_file_that_is_cut_off_is_read_as_far_as_it_goes(recorded, tmp_path):
    many = 20 * control_states(recorded)  # several chunks of 1 MiB
    content = rewrite(recorded, tmp_path / "whole.mcap", many).path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) // 2])
    cut = ServerRecording.open(tmp_path / "cut.mcap")
    assert not cut.is_complete
    assert 0 < len(list(cut.exchanges())) < len(many)


def test_a_hand_that_changed_is_noted(recorded):
    hands = {HAND.name: HAND.derated(0.5)}
    assert any("has changed" in note for note in Replay(recorded, hands).run().notes)
    assert load_hands(recorded)[HAND.name].name == HAND.name


@pytest.mark.parametrize("content", [b"", b"no archive", b"\x89MCAP0\r\n"])
def test_other_files_are_refused(content, tmp_path):
    (tmp_path / "other.mcap").write_bytes(content)
    with pytest.raises(InvalidInput, match="graspforce serve --record"):
        ServerRecording.open(tmp_path / "other.mcap")


@pytest.mark.parametrize("states_before", [0, 1, 7], ids="{} states before".format)
def test_a_change_of_contacts_begins_where_it_began(recorded, tmp_path, states_before):
    """The preparation of a change takes any number of states in a server; here the executor determines it."""
    states = control_states(recorded)
    stream = f"streams/{states[0].key}"
    opening = next(each for each in recorded.exchanges() if each.kind == REQUEST and each.key == stream)
    setup = read_setup(HANDS, protocol.Envelope.split(protocol.decode(opening.payload, opening.encoding))[1])
    changes, exchanges = HeldChanges(), [opening]
    server_stream = ServerStream("a", setup, changes=changes)
    change = NumberedChange(1, ContactChange(release=[GRASP.fingers[1]], force_rate=200.0))
    for number in range(12):
        if number == states_before:
            changes.release()
        payload = StreamState(number, 0.0, REST, TARGET, contacts=change).encode(protocol.MSGPACK)
        reply = server_stream.command(payload, protocol.MSGPACK, float(number))
        codec = protocol.MSGPACK
        exchanges.append(
            Exchange(STATE, states[0].key, float(number), float(number), payload, codec, True, reply.payload, codec)
        )
    numbers = [protocol.decode(each.reply, protocol.MSGPACK)["contact_change"]["number"] for each in exchanges[1:]]
    assert numbers == [0] * states_before + [1] * (12 - states_before)
    report = Replay(rewrite(recorded, tmp_path / "change.mcap", exchanges), HANDS).run()
    assert report.sources[states[0].source].equal == 12


def exchange(number: int, size: int = 4096) -> Exchange:
    """Return a request and its reply of some size."""
    return Exchange(REQUEST, "solve", float(number), float(number), bytes(size), None, True, b"", protocol.JSON)


def test_a_slow_disk_drops_exchanges_and_counts_them(tmp_path):
    """The process reads nothing: offers return at once, and all but the bytes of the queue are dropped."""
    sleeping = (sys.executable, "-c", "import time; time.sleep(600)")
    recorder = Recorder(tmp_path / "slow.mcap", RecorderOptions(queue_bytes=20_000, command=sleeping))
    recorder.start([], {})
    try:
        wait_until(lambda: recorder.offer(exchange(0)) or recorder.dropped["requests"] > 100)
        assert recorder.written * 4096 < 2**20  # no more than a pipe holds
    finally:
        recorder._process.kill()
        recorder.close(TIMEOUT)


def test_a_gap_is_marked_at_the_next_exchange(tmp_path):
    recorder = Recorder(tmp_path / "gap.mcap", RecorderOptions(queue_bytes=10_000))
    for number in range(5):  # not started: nothing leaves the queue
        recorder.offer(exchange(number))
    assert recorder.dropped["requests"] == 3
    recorder._queue.clear()
    recorder._bytes = 0
    recorder.offer(last := exchange(5))
    assert last.dropped == 3


def test_a_process_that_ends_early_is_no_failure_of_the_server(tmp_path, caplog):
    ending = (sys.executable, "-c", "raise SystemExit(1)")
    recorder = Recorder(tmp_path / "ended.mcap", RecorderOptions(command=ending))
    recorder.start([], {})
    wait_until(lambda: recorder.offer(exchange(0)) or recorder.dropped["requests"] > 0)
    recorder.close(TIMEOUT)
    assert "ended early" in caplog.text


def test_the_end_states_what_was_dropped(recorded):
    assert recorded.is_complete
    assert recorded.dropped == {}
    with recorded.path.open("rb") as file:
        ends = [each.metadata for each in reader_module.make_reader(file).iter_metadata() if each.name == END]
    assert [int(each["written"]) for each in ends] == [len(list(recorded.exchanges()))]
    assert msgspec.json.decode(ends[0]["dropped"]) == {}
