"""Control over the wire, without a network: steps as they are in Python, streams opened and closed, nothing gets through."""

from __future__ import annotations

import json
import random
import time

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.control_requests import (
    BAD_GRASP,
    BAD_OPENING,
    BAD_STATE,
    BAD_STREAM_STATE,
    EXTERNAL,
    GRASP,
    HAND,
    SETTINGS,
    desired,
    desired_with_joints,
    memory,
    request,
    sent,
    setup,
    state,
    with_change,
)

from graspforce.control import GraspMotion, ObjectController, object_motion
from graspforce.control.object_controller import ObjectControlLaw
from graspforce.core.errors import InvalidInput, RequestRefused, UnknownName
from graspforce.service import ControlRequest, RequestHandler, ServerLimits, StreamSetup, StreamState
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.server.stream_registry import StreamRegistry
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import CommandRecord, read_command
from graspforce.service.wire.protocol import JSON, MSGPACK

CODECS = pytest.mark.parametrize("codec", [JSON, MSGPACK])
CONTROL = f"hands/{HAND.name}/control"
HANDS = {HAND.name: HAND}
STEP = (
    "tau",
    "f",
    "w",
    "acceleration",
    "joint_acceleration",
    "error",
    "slip_margin",
    "creep",
    "uncontrollable",
    "structural_wrench",
)
ROUNDING = 1e-12  # of numbers of order 1: normals and tangents of the contacts are normalised once more on arrival


def as_sent(record, codec):
    """A record as a stranger's program sends it: Python's own JSON writes NaN."""
    return json.dumps(record).encode() if codec == JSON else protocol.encode(record, codec)


def same_step(remote, command, left):
    """The command that came says what the one in this process says, and leaves the same memory."""
    for name in STEP:
        np.testing.assert_allclose(getattr(remote, name), getattr(command, name), rtol=1e-9, atol=ROUNDING, err_msg=name)
    for name in ("saturated", "forces_reused", "warnings"):
        assert getattr(remote, name) == getattr(command, name)
    np.testing.assert_allclose(remote.contacts.p_OC, command.contacts.p_OC, atol=ROUNDING)
    np.testing.assert_allclose(remote.contacts.R_OC, command.contacts.R_OC, atol=ROUNDING)
    np.testing.assert_array_equal(remote.contacts.mu, command.contacts.mu)
    for name in ("integral", "R_OC", "creep", "f"):
        np.testing.assert_allclose(getattr(remote.memory, name), getattr(left, name), rtol=1e-9, atol=ROUNDING)
    for name in ("p_OF", "R_OF", "p_OC"):
        np.testing.assert_allclose(
            getattr(remote.memory.tip_contacts, name), getattr(left.tip_contacts, name), rtol=1e-9, atol=ROUNDING
        )


def quiet(record):
    """A record's plain values: NumPy's have no equality of their own."""
    return msgspec.to_builtins(record, enc_hook=lambda value: value.tolist())


# ── records ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@CODECS
def test_requests_and_openings_come_back(codec):
    for record, read in ((request(), HAND), (setup(), HANDS)):
        back = type(record).from_dict(read, protocol.decode(protocol.encode(record.to_dict(), codec), codec))
        there, here = quiet(back.to_dict()), quiet(record.to_dict())
        frames = [[contact.pop("tangent") for contact in each["hold"]["contacts"]] for each in (there, here)]
        assert there == here
        np.testing.assert_allclose(*frames, atol=ROUNDING)


def test_what_is_not_said_has_its_default():
    bare = setup().to_dict()
    for name in ("settings", "validity", "memory"):
        del bare[name]
    assert quiet(StreamSetup.from_dict(HANDS, bare).to_dict()) == quiet(StreamSetup(GRASP).to_dict())
    record = request().to_dict()
    for name in ("settings", "external", "memory"):
        del record[name]
    del record["state"]["velocity"], record["state"]["object"]["twist"], record["desired"]["twist"]
    del record["desired"]["joints"]["velocity"], record["desired"]["joints"]["acceleration"]
    back = ControlRequest.from_dict(HAND, record)
    assert (back.external, back.memory) == (None, None)
    for zeros in (back.state.v, back.state.object.twist, back.desired.object.twist, back.desired.v, back.desired.a):
        assert not zeros.any()


@CODECS
def test_a_state_comes_back_by_the_quick_way_and_by_the_slow(codec):
    plain = sent().to_dict()
    x, y, z, w = Rotation.from_matrix(state().object.R_HO).as_quat()
    turned = with_change(plain, ("state", "object", "quaternion"), [w, x, y, z])
    del turned["state"]["object"]["rotation"]
    for record in (plain, turned):
        back = StreamState.decode(HAND, protocol.encode(record, codec), codec)
        assert (back.sequence, back.time) == (7, 12.25)
        np.testing.assert_array_equal(back.state.q, state().q)
        np.testing.assert_array_equal(back.state.v, state().v)
        np.testing.assert_allclose(back.state.object.R_HO, state().object.R_HO, atol=ROUNDING)
        np.testing.assert_array_equal(back.state.object.twist, state().object.twist)
        np.testing.assert_array_equal(back.desired.object.acceleration, desired().acceleration)
        for name in ("q", "v", "a"):
            np.testing.assert_array_equal(getattr(back.desired, name), getattr(desired_with_joints(), name))
        np.testing.assert_array_equal(back.external, EXTERNAL)


def binary(record):
    """A record whose arrays are what a C program has in its memory."""
    if isinstance(record, dict):
        return {name: binary(item) for name, item in record.items()}
    return np.array(record, dtype="<f8").tobytes() if isinstance(record, list) else record


def same_state(back, here):
    assert type(back.desired) is type(here.desired)
    for there, wanted in ((back.state.object, here.state.object), (object_motion(back.desired), object_motion(here.desired))):
        for name in ("p_HO", "R_HO", "twist"):
            np.testing.assert_array_equal(getattr(there, name), getattr(wanted, name))
    for name in ("q", "v"):
        np.testing.assert_array_equal(getattr(back.state, name), getattr(here.state, name))
    np.testing.assert_array_equal(object_motion(back.desired).acceleration, object_motion(here.desired).acceleration)
    if isinstance(here.desired, GraspMotion):
        for name in ("q", "v", "a"):
            np.testing.assert_array_equal(getattr(back.desired, name), getattr(here.desired, name))
    np.testing.assert_array_equal(back.external, here.external)


WANTED = pytest.mark.parametrize("wanted", [desired(), desired_with_joints()], ids=["object", "joints too"])


@WANTED
def test_arrays_may_be_binary_all_of_them_or_some(wanted):
    here = sent(wanted=wanted)
    plain = here.to_dict()
    packed = binary(plain)
    assert protocol.decode(here.encode(MSGPACK), MSGPACK) == packed
    assert protocol.decode(here.encode(JSON), JSON) == plain
    for record, kind in ((plain, False), (packed, True), ({**plain, "desired": packed["desired"]}, False)):
        back = StreamState.decode(HAND, protocol.encode(record, MSGPACK), MSGPACK)
        same_state(back, here)
        assert back.binary is kind
    mixed = {**packed, "desired": plain["desired"], "external": packed["external"]}
    same_state(StreamState.decode(HAND, protocol.encode(mixed, MSGPACK), MSGPACK), here)
    with pytest.raises(InvalidInput, match=r"state\.posture"):  # JSON's text is no array, base64 or not
        StreamState.decode(HAND, protocol.encode(packed, JSON), JSON)


@WANTED
def test_what_came_is_what_another_constructor_would_have_made(wanted):
    """The quick way leaves out the checks of `GraspState`, `GraspMotion` and `BodyMotion`, and nothing else."""
    here = sent(wanted=wanted)
    back = StreamState.decode(HAND, here.encode(MSGPACK), MSGPACK)
    same_state(StreamState.from_dict(HAND, here.to_dict()), back)
    joints = (back.desired.q, back.desired.v, back.desired.a) if isinstance(back.desired, GraspMotion) else ()
    for motion in (back.state.object, object_motion(back.desired)):
        for array in (motion.p_HO, motion.R_HO, motion.twist, motion.acceleration, *joints):
            assert array.dtype == np.float64
            assert not array.flags.writeable
    assert not back.state.object.acceleration.any()


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        (("state", "posture"), np.zeros(HAND.n + 1).tobytes(), "state.posture"),
        (("state", "posture"), b"1234567", "state.posture"),
        (("state", "velocity"), np.full(HAND.n, np.nan).tobytes(), "state.velocity[0]"),
        (("state", "object", "rotation"), (2.0 * np.eye(3)).tobytes(), "state.object.rotation"),
        (("desired", "rotation"), np.diag([1.0, 1.0, -1.0]).tobytes(), "desired.rotation"),
        (("desired", "acceleration"), np.array([0.0] * 5 + [np.inf]).tobytes(), "desired.acceleration[5]"),
        (("desired", "joints", "velocity"), np.zeros(HAND.n - 1).tobytes(), "desired.joints.velocity"),
        (("external",), b"", "external"),
    ],
)
def test_bad_binary_arrays_are_named(path, value, field):
    stream = ServerStream("a", setup())
    reply = stream.command(protocol.encode(with_change(binary(sent().to_dict()), path, value), MSGPACK), MSGPACK)
    assert not reply.ok
    record = protocol.decode(reply.payload, MSGPACK)
    assert (record["error"], record["field"], record["sequence"]) == ("invalid", field, 7)
    assert stream.command(sent().encode(MSGPACK), MSGPACK).ok


def test_binary_states_get_the_same_command_in_binary():
    plain, packed = (ServerStream("a", setup()) for _ in range(2))
    listed = protocol.decode(plain.command(protocol.encode(sent().to_dict(), MSGPACK), MSGPACK).payload, MSGPACK)
    answer = packed.command(sent().encode(MSGPACK), MSGPACK)
    record = protocol.decode(answer.payload, MSGPACK)
    for name in ("torque", "force", "positions", "wrench", "pose_error", "slip_margin", "borne", "uncontrollable"):
        assert record[name] == binary(listed[name])
    assert record["memory"] == binary(listed["memory"])
    one, other = (msgspec.convert(each, CommandRecord).unpack(GRASP) for each in (listed, record))
    for name in STEP:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    np.testing.assert_array_equal(one.contacts.R_OC, other.contacts.R_OC)
    np.testing.assert_array_equal(one.memory.tip_contacts.p_OF, other.memory.tip_contacts.p_OF)
    for name in ("joint_acceleration", "positions", "slip_margin", "uncontrollable"):
        with pytest.raises(InvalidInput, match="wrong size"):
            read_command(GRASP, {**record, name: record["force"][:-8]})
    with pytest.raises(InvalidInput, match="wrong size"):
        read_command(GRASP, with_change(record, ("memory", "frames"), record["force"]))


@pytest.mark.parametrize("path", [("acceleration",), ("joints", "velocity"), ("joints", "acceleration")])
def test_binary_states_get_binary_commands_also_where_they_leave_out_what_has_a_default(path):
    record = binary(with_change(sent().to_dict(), ("desired", *path), ...))
    reply = ServerStream("a", setup()).command(protocol.encode(record, MSGPACK), MSGPACK)
    assert reply.ok
    assert isinstance(protocol.decode(reply.payload, MSGPACK)["torque"], bytes)


# ── one step ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


@CODECS
@pytest.mark.parametrize("left", [None, memory()], ids=["first", "later"])
def test_a_request_gets_the_step_that_python_makes(codec, left):
    law = ObjectControlLaw(GRASP, SETTINGS)
    command, after = law.step(left or law.initial_memory(), state(), desired_with_joints(), EXTERNAL)
    payload = protocol.encode({**request(memory=left).to_dict(), "sequence": 11, "budget": 30.0}, codec)
    reply = RequestHandler([HAND]).answer(CONTROL, payload, codec)
    assert (reply.ok, reply.encoding) == (True, codec)
    remote = read_command(GRASP, protocol.decode(reply.payload, codec))
    same_step(remote, command, after)
    assert remote.sequence == 11
    assert remote.solution.certificate.verified
    assert 0.0 < remote.server_seconds < 30.0


@CODECS
def test_a_stream_steps_as_the_controller_in_this_process(codec):
    controller = ObjectController(GRASP, SETTINGS)
    stream = ServerStream("a", setup(memory=None))
    read = msgspec.json.Decoder(CommandRecord) if codec == JSON else msgspec.msgpack.Decoder(CommandRecord)
    for i in range(20):
        command = controller.step(state(i), desired_with_joints(), EXTERNAL)
        reply = stream.command(protocol.encode(sent(i, seed=i).to_dict(), codec), codec)
        assert (reply.ok, reply.encoding) == (True, codec)
        record = read.decode(reply.payload)
        same_step(record.unpack(GRASP), command, controller.memory)
        assert (record.sequence, record.time) == (i, 12.25)
        assert record.late == (record.server_seconds > 0.05)
    assert stream.outcomes == {"ok": 20}
    assert np.abs(controller.memory.integral).max() > 0.0  # the steps are not alike


def test_a_stream_goes_on_from_what_an_earlier_one_left():
    """A stream that is opened again with the last command's memory commands what one that was never lost does."""
    first = ServerStream("a", setup(memory=None))
    read = msgspec.msgpack.Decoder(CommandRecord).decode
    for i in range(5):
        last = read(first.command(protocol.encode(sent(i, seed=i).to_dict(), MSGPACK), MSGPACK).payload).unpack(GRASP)
    again = protocol.encode(setup(memory=last.memory).to_dict(), MSGPACK)
    second = ServerStream("a", StreamSetup.from_dict(HANDS, protocol.decode(again, MSGPACK)))
    payload = protocol.encode(sent(5, seed=9).to_dict(), MSGPACK)
    fresh = ServerStream("a", setup(memory=None))
    one, other, new = (read(each.command(payload, MSGPACK).payload).unpack(GRASP) for each in (first, second, fresh))
    for name in ("w", "acceleration", "joint_acceleration", "creep"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-9, atol=ROUNDING, err_msg=name)
    np.testing.assert_allclose(other.memory.integral, one.memory.integral, rtol=1e-12)
    assert np.abs(new.acceleration - one.acceleration).max() > 1e-3  # m/s²: the integral tells
    # a solver that starts cold: a cost known to 1e-8 knows the forces where it is curved to the root of that
    np.testing.assert_allclose(other.f, one.f, atol=1e-4 * np.abs(one.f).max())
    np.testing.assert_allclose(other.tau, one.tau, atol=1e-4 * np.abs(one.tau).max())


def test_what_was_skipped_is_counted():
    stream = ServerStream("a", setup())
    for sequence in (3, 4, 8, 9):
        assert stream.command(protocol.encode(sent(sequence).to_dict(), MSGPACK), MSGPACK).ok
    assert stream.skipped == 3
    assert stream.command(protocol.encode(sent(0).to_dict(), MSGPACK), MSGPACK).ok  # a driver that began again
    assert stream.skipped == 3


def test_a_command_that_took_longer_than_it_is_valid_is_marked():
    stream = ServerStream("a", setup(validity=0.05))
    payload = protocol.encode(sent().to_dict(), MSGPACK)
    late = stream.command(payload, MSGPACK, received=time.perf_counter() - 0.06)
    assert protocol.decode(late.payload, MSGPACK)["late"] is True
    assert protocol.decode(late.payload, MSGPACK)["server_seconds"] > 0.06


# ── opening and closing ────────────────────────────────────────────────────────────────────────────────────────────────────


def streams_of(**change):
    opened, closed = [], []
    limits = {"capacity": 3, "idle_timeout": 10.0, **change}
    return StreamRegistry(HANDS, on_open=opened.append, on_close=closed.append, **limits), opened, closed


def test_a_stream_is_opened_once_and_closed_once():
    streams, opened, closed = streams_of()
    assert streams.answer("a", setup().to_dict()) == {"stream": "a", "opened": True, "idle": 10.0}
    assert len(streams) == 1
    assert opened == [streams["a"]]
    # once more the same, whatever an earlier stream left: nothing changes
    assert streams.answer("a", setup(memory=None).to_dict())["opened"] is False
    assert len(opened) == 1
    with pytest.raises(InvalidInput, match="a new id: the open stream with this id has other parameters"):
        streams.answer("a", setup(validity=0.06).to_dict())
    streams["a"].command(b"", None)
    assert streams.outcomes() == {"invalid": 1}
    assert streams.answer("a", {"close": True}) == {"stream": "a", "outcomes": {"invalid": 1}, "skipped": 0}
    assert (len(streams), closed) == (0, opened)
    assert streams.outcomes() == {"invalid": 1}
    with pytest.raises(UnknownName, match="the id of an open stream"):
        streams.answer("a", {"close": True})
    assert len(closed) == 1


def test_there_is_room_for_so_many():
    streams, opened, _ = streams_of(capacity=2)
    for id in ("a", "b", "a"):
        streams.answer(id, setup().to_dict())
    with pytest.raises(RequestRefused, match="2 streams are open") as caught:
        streams.answer("c", setup().to_dict())
    assert caught.value.code == "overloaded"
    streams.answer("a", {"close": True})
    assert streams.answer("c", setup().to_dict())["opened"]
    assert [stream.id for stream in opened] == ["a", "b", "c"]


def test_a_stream_without_states_expires_and_others_do_not():
    streams, _, closed = streams_of(idle_timeout=10.0)
    for id in ("dead", "alive"):
        streams.answer(id, setup().to_dict())
    now = time.perf_counter()
    streams["alive"].command(b"", None, received=now + 9.0)
    streams.expire(now + 9.9)
    assert len(streams) == 2
    streams.expire(now + 11.0)
    assert [stream.id for stream in closed] == ["dead"]
    streams.close()
    assert [stream.id for stream in closed] == ["dead", "alive"]
    assert len(streams) == 0


def test_the_handler_opens_counts_and_closes():
    handler = RequestHandler([HAND], limits=ServerLimits(streams=1))

    def ask(key, record):
        reply = handler.answer(key, protocol.encode(record, MSGPACK), MSGPACK)
        return reply.ok, protocol.decode(reply.payload, MSGPACK)

    ok, said = ask("streams/a", {**setup().to_dict(), "sequence": 5})
    assert ok
    assert (said["stream"], said["sequence"], said["opened"]) == ("a", 5, True)
    assert handler.streams["a"].command(protocol.encode(sent().to_dict(), MSGPACK), MSGPACK).ok
    assert ask("streams/b", setup().to_dict())[1]["error"] == "overloaded"
    assert ask("status", {})[1]["streams"] == 1
    assert ask("streams/a", {"close": True})[0]
    status = ask("status", {})[1]
    assert status["streams"] == 0
    assert status["counts"]["streams"] == {"ok": 2, "overloaded": 1}
    assert status["counts"]["streams/*/state"] == {"ok": 1}
    assert ask("streams/a/state", {})[1]["error"] == "unknown"
    many = with_change(setup().to_dict(), ("hold", "contacts"), [{}] * 501)
    assert ask("streams/a", many)[1]["error"] == "too_large"
    for key, record in (("streams/a", setup().to_dict()), (CONTROL, request().to_dict())):
        ok, error = ask(key, {**record, "backend": "clarabel"})
        assert (ok, error["error"], error["field"]) == (False, "invalid", "backend")


# ── errors ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def kinds():
    """(record, key, how Python reads it, its faults)"""
    asked, opened = request().to_dict(), setup().to_dict()
    return [
        *((asked, CONTROL, lambda record: ControlRequest.from_dict(HAND, record), fault) for fault in BAD_GRASP + BAD_STATE),
        *((opened, "streams/a", lambda record: StreamSetup.from_dict(HANDS, record), fault) for fault in BAD_OPENING),
    ]


@CODECS
@pytest.mark.parametrize(("record", "key", "read", "fault"), kinds())
def test_bad_requests_and_openings_get_the_text_that_python_gives(record, key, read, fault, codec):
    path, value, field, allowed = fault
    bad = with_change(record, path, value)
    with pytest.raises(InvalidInput) as caught:
        read(bad)
    assert caught.value.field == field
    assert caught.value.allowed.startswith(allowed)
    reply = RequestHandler([HAND]).answer(key, as_sent(bad, codec), codec)
    expected = {"error": caught.value.code, "message": str(caught.value), "field": field}
    assert (reply.ok, protocol.decode(reply.payload, codec)) == (False, expected)


@CODECS
@pytest.mark.parametrize(("path", "value", "field", "allowed"), BAD_STREAM_STATE)
def test_bad_states_get_the_text_that_python_gives_and_the_stream_lives(path, value, field, allowed, codec):
    bad = with_change(sent().to_dict(), path, value)
    with pytest.raises(InvalidInput) as caught:
        StreamState.from_dict(HAND, bad)
    assert caught.value.field == field
    assert caught.value.allowed.startswith(allowed)
    stream = ServerStream("a", setup())
    reply = stream.command(as_sent(bad, codec), codec)
    expected = {"error": "invalid", "message": str(caught.value), "field": field}
    if field != "sequence":
        expected["sequence"] = 7
    assert (reply.ok, protocol.decode(reply.payload, codec)) == (False, expected)
    assert stream.command(protocol.encode(sent().to_dict(), codec), codec).ok


@pytest.mark.parametrize("record", [{}, {"close": False}, {"close": True, "hand": 1}, [1], None, 3.5])
def test_what_neither_opens_nor_closes_is_bad_input(record):
    reply = RequestHandler([HAND]).answer("streams/a", protocol.encode(record, MSGPACK), MSGPACK)
    assert protocol.decode(reply.payload, MSGPACK)["error"] == "invalid"


def test_a_state_that_is_too_large_is_refused():
    reply = ServerStream("a", setup()).command(b" " * 70_000, JSON)
    assert protocol.decode(reply.payload, JSON)["error"] == "too_large"


def test_numbers_that_overflow_leave_no_trace():
    """Finite numbers whose squares are none: refused, and the next state gets what it would have got."""
    stream, other = (ServerStream("a", setup(memory=None)) for _ in range(2))
    wild = with_change(sent().to_dict(), ("state", "object", "position"), [1e308, -1e308, 1e308])
    reply = stream.command(protocol.encode(wild, MSGPACK), MSGPACK)
    record = protocol.decode(reply.payload, MSGPACK)
    assert not reply.ok or np.isfinite(record["torque"]).all()
    if not reply.ok:
        payload = protocol.encode(sent().to_dict(), MSGPACK)
        one, two = (protocol.decode(each.command(payload, MSGPACK).payload, MSGPACK)["torque"] for each in (stream, other))
        np.testing.assert_allclose(one, two, rtol=1e-6, atol=1e-9)


# ── nothing gets through ───────────────────────────────────────────────────────────────────────────────────────────────────

HANDLER = RequestHandler([HAND], limits=ServerLimits(streams=1))
STREAM = ServerStream("s", setup())


def survives(kind, payload, codec):
    """Whether it is an answer: one or an error record it must be, never the server's own fault, never a torque that is none."""
    if kind == "state":
        reply = STREAM.command(payload, codec)
    else:
        reply = HANDLER.answer(CONTROL if kind == "control" else "streams/a", payload, codec)
    record = protocol.decode(reply.payload, reply.encoding)
    assert reply.ok == ("error" not in record)
    if not reply.ok:
        assert record["error"] in ("invalid", "unknown", "too_large"), record
    elif kind != "opening":
        torque = record["torque"]
        assert np.isfinite(np.frombuffer(torque) if isinstance(torque, bytes) else torque).all()
    return reply.ok


ORIGINALS = {"control": request().to_dict(), "opening": setup().to_dict(), "state": sent().to_dict()}
PACKED = sent().encode(MSGPACK)
KINDS = pytest.mark.parametrize("kind", list(ORIGINALS))


@given(kind=st.sampled_from(list(ORIGINALS)), payload=st.binary(max_size=200), codec=st.sampled_from([JSON, MSGPACK]))
def test_random_bytes_get_a_reply(kind, payload, codec):
    survives(kind, payload, codec)


@CODECS
@KINDS
def test_every_truncation_gets_an_error(kind, codec):
    payload = protocol.encode(ORIGINALS[kind], codec)
    for end in range(0, len(payload), 13):
        assert not survives(kind, payload[:end], codec)


@CODECS
@KINDS
def test_mutated_bytes_get_a_reply(kind, codec):
    chance, whole = random.Random(20250111), protocol.encode(ORIGINALS[kind], codec)
    outcomes = set()
    for _ in range(120):
        mutated = bytearray(whole)
        for _ in range(chance.randint(1, 3)):
            place = chance.randrange(len(mutated))
            if chance.randrange(3):
                mutated[place] ^= 1 << chance.randrange(8)
            else:
                del mutated[place : place + chance.randint(1, 5)]
        outcomes.add(survives(kind, bytes(mutated), codec))
        if kind == "opening":
            HANDLER.streams.close()
    assert outcomes == {True, False}  # some changes leave a request, others leave none


@settings(max_examples=300, deadline=None)
@given(place=st.integers(0, len(PACKED) - 1), byte=st.integers(0, 255), end=st.integers(0, len(PACKED)))
def test_mutated_binary_arrays_get_a_reply(place, byte, end):
    survives("state", PACKED[:place] + bytes([byte]) + PACKED[place + 1 :], MSGPACK)
    survives("state", PACKED[:end], MSGPACK)


def paths(value, path=()):
    """Every place in a record."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value[:2]) if isinstance(value, list) else ()
    for name, item in items:
        yield from paths(item, (*path, name))


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)
PLACES = [(kind, path) for kind, record in ORIGINALS.items() for path in paths(quiet(record)) if path]


@settings(max_examples=150, deadline=None)
@given(place=st.sampled_from(PLACES), value=ANYTHING, codec=st.sampled_from([JSON, MSGPACK]))
def test_anything_in_any_place_gets_a_reply(place, value, codec):
    kind, path = place
    survives(kind, as_sent(with_change(ORIGINALS[kind], path, value), codec), codec)
    HANDLER.streams.close()


@settings(max_examples=60, deadline=None)
@given(numbers=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=15, max_size=15))
def test_numbers_of_any_size_get_a_reply(numbers):
    record = sent().to_dict()
    record["state"]["object"]["position"] = numbers[:3]
    record["state"]["object"]["twist"] = numbers[3:9]
    record["desired"]["twist"] = numbers[9:15]
    survives("state", protocol.encode(record, MSGPACK), MSGPACK)
