"""Records of control on the wire."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.control_requests import (
    CODECS,
    COMMAND_FIELDS,
    EXTERNAL,
    GRASP,
    HAND,
    HANDS,
    ROUNDING,
    desired,
    desired_with_joints,
    request,
    setup,
    state,
    stream_state,
    to_binary,
    to_plain,
    with_change,
)

from graspforce.control import GraspMotion, object_motion
from graspforce.core.errors import InvalidInput
from graspforce.service import ControlRequest, StreamSetup, StreamState
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import CommandRecord, read_command
from graspforce.service.wire.protocol import JSON, MSGPACK


@CODECS
def test_requests_and_setups_survive_the_wire(codec):
    for record, read in ((request(), HAND), (setup(), HANDS)):
        back = type(record).from_dict(read, protocol.decode(protocol.encode(record.to_dict(), codec), codec))
        there, here = to_plain(back.to_dict()), to_plain(record.to_dict())
        frames = [[contact.pop("tangent") for contact in each["hold"]["contacts"]] for each in (there, here)]
        assert there == here
        np.testing.assert_allclose(*frames, atol=ROUNDING)


def test_absent_fields_take_their_defaults():
    bare = setup().to_dict()
    for name in ("settings", "validity", "memory"):
        del bare[name]
    assert to_plain(StreamSetup.from_dict(HANDS, bare).to_dict()) == to_plain(StreamSetup(GRASP).to_dict())
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
def test_state_survives_the_fast_and_the_slow_path(codec):
    plain = stream_state().to_dict()
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


def assert_same_state(back, here):
    """Check that two states have equal numbers."""
    assert type(back.desired) is type(here.desired)
    motions = ((back.state.object, here.state.object), (object_motion(back.desired), object_motion(here.desired)))
    for there, expected in motions:
        for name in ("p_HO", "R_HO", "twist"):
            np.testing.assert_array_equal(getattr(there, name), getattr(expected, name))
    for name in ("q", "v"):
        np.testing.assert_array_equal(getattr(back.state, name), getattr(here.state, name))
    np.testing.assert_array_equal(object_motion(back.desired).acceleration, object_motion(here.desired).acceleration)
    if isinstance(here.desired, GraspMotion):
        for name in ("q", "v", "a"):
            np.testing.assert_array_equal(getattr(back.desired, name), getattr(here.desired, name))
    np.testing.assert_array_equal(back.external, here.external)


MOTIONS = pytest.mark.parametrize("motion", [desired(), desired_with_joints()], ids=["object", "joints too"])


@MOTIONS
def test_any_arrays_may_be_binary(motion):
    here = stream_state(motion=motion)
    plain = here.to_dict()
    packed = to_binary(plain)
    assert protocol.decode(here.encode(MSGPACK), MSGPACK) == packed
    assert protocol.decode(here.encode(JSON), JSON) == plain
    for record, kind in ((plain, False), (packed, True), ({**plain, "desired": packed["desired"]}, False)):
        back = StreamState.decode(HAND, protocol.encode(record, MSGPACK), MSGPACK)
        assert_same_state(back, here)
        assert back.binary is kind
    mixed = {**packed, "desired": plain["desired"], "external": packed["external"]}
    assert_same_state(StreamState.decode(HAND, protocol.encode(mixed, MSGPACK), MSGPACK), here)
    with pytest.raises(InvalidInput, match=r"state\.posture"):  # base64 text is not an array
        StreamState.decode(HAND, protocol.encode(packed, JSON), JSON)


@MOTIONS
def test_fast_path_equals_the_validating_constructors(motion):
    """The fast path omits only the checks of `GraspState`, `GraspMotion` and `BodyMotion`."""
    here = stream_state(motion=motion)
    back = StreamState.decode(HAND, here.encode(MSGPACK), MSGPACK)
    assert_same_state(StreamState.from_dict(HAND, here.to_dict()), back)
    joints = (back.desired.q, back.desired.v, back.desired.a) if isinstance(back.desired, GraspMotion) else ()
    for each in (back.state.object, object_motion(back.desired)):
        for array in (each.p_HO, each.R_HO, each.twist, each.acceleration, *joints):
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
def test_invalid_binary_arrays_are_named(path, value, field):
    stream = ServerStream("a", setup())
    reply = stream.command(protocol.encode(with_change(to_binary(stream_state().to_dict()), path, value), MSGPACK), MSGPACK)
    assert not reply.ok
    record = protocol.decode(reply.payload, MSGPACK)
    assert (record["error"], record["field"], record["sequence"]) == ("invalid", field, 7)
    assert stream.command(stream_state().encode(MSGPACK), MSGPACK).ok


def test_binary_states_get_the_same_command_in_binary():
    plain, packed = (ServerStream("a", setup()) for _ in range(2))
    listed = protocol.decode(plain.command(protocol.encode(stream_state().to_dict(), MSGPACK), MSGPACK).payload, MSGPACK)
    answer = packed.command(stream_state().encode(MSGPACK), MSGPACK)
    record = protocol.decode(answer.payload, MSGPACK)
    for name in ("torque", "force", "positions", "wrench", "pose_error", "slip_margin", "borne", "uncontrollable"):
        assert record[name] == to_binary(listed[name])
    assert record["memory"] == to_binary(listed["memory"])
    one, other = (msgspec.convert(each, CommandRecord).unpack(GRASP) for each in (listed, record))
    for name in COMMAND_FIELDS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    np.testing.assert_array_equal(one.contacts.R_OC, other.contacts.R_OC)
    np.testing.assert_array_equal(one.memory.tip_contacts.p_OF, other.memory.tip_contacts.p_OF)
    for name in ("joint_acceleration", "positions", "slip_margin", "uncontrollable"):
        with pytest.raises(InvalidInput, match="wrong size"):
            read_command(GRASP, {**record, name: record["force"][:-8]})
    with pytest.raises(InvalidInput, match="wrong size"):
        read_command(GRASP, with_change(record, ("memory", "frames"), record["force"]))


@pytest.mark.parametrize("path", [("acceleration",), ("joints", "velocity"), ("joints", "acceleration")])
def test_binary_states_with_default_fields_get_binary_commands(path):
    record = to_binary(with_change(stream_state().to_dict(), ("desired", *path), ...))
    reply = ServerStream("a", setup()).command(protocol.encode(record, MSGPACK), MSGPACK)
    assert reply.ok
    assert isinstance(protocol.decode(reply.payload, MSGPACK)["torque"], bytes)
