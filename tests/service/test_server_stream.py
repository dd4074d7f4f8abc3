"""Steps of control streams and requests, without a network."""

from __future__ import annotations

import time
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from support.control_requests import (
    CODECS,
    COMMAND_FIELDS,
    CONTROL,
    EXTERNAL,
    GRASP,
    HAND,
    HANDS,
    ROUNDING,
    SETTINGS,
    desired_with_joints,
    memory,
    request,
    setup,
    state,
    stream_state,
)

from graspforce.control import ObjectController
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.hand.drives.drive import Drive
from graspforce.service import RequestHandler, StreamSetup
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import CommandRecord, read_command
from graspforce.service.wire.protocol import JSON, MSGPACK


def assert_same_step(remote, command, memory):
    """Check that a received command and its memory equal local ones."""
    for name in COMMAND_FIELDS:
        np.testing.assert_allclose(getattr(remote, name), getattr(command, name), rtol=1e-9, atol=ROUNDING, err_msg=name)
    for name in ("saturated", "forces_reused", "warnings"):
        assert getattr(remote, name) == getattr(command, name)
    np.testing.assert_allclose(remote.contacts.p_OC, command.contacts.p_OC, atol=ROUNDING)
    np.testing.assert_allclose(remote.contacts.R_OC, command.contacts.R_OC, atol=ROUNDING)
    np.testing.assert_array_equal(remote.contacts.mu, command.contacts.mu)
    for name in ("integral", "R_OC", "creep", "f"):
        np.testing.assert_allclose(getattr(remote.memory, name), getattr(memory, name), rtol=1e-9, atol=ROUNDING)
    for name in ("p_OF", "R_OF", "p_OC"):
        np.testing.assert_allclose(
            getattr(remote.memory.tip_contacts, name), getattr(memory.tip_contacts, name), rtol=1e-9, atol=ROUNDING
        )


@CODECS
@pytest.mark.parametrize("earlier", [None, memory()], ids=["first", "later"])
def test_control_request_returns_the_step_of_python(codec, earlier):
    law = ObjectControlLaw(GRASP, SETTINGS)
    command, after = law.step(earlier or law.initial_memory(), state(), desired_with_joints(), EXTERNAL)
    payload = protocol.encode({**request(memory=earlier).to_dict(), "sequence": 11, "budget": 30.0}, codec)
    reply = RequestHandler([HAND]).answer(CONTROL, payload, codec)
    assert (reply.ok, reply.encoding) == (True, codec)
    remote = read_command(GRASP, protocol.decode(reply.payload, codec))
    assert_same_step(remote, command, after)
    assert remote.sequence == 11
    assert remote.solution.certificate.verified
    assert 0.0 < remote.server_seconds < 30.0


@CODECS
def test_stream_steps_like_a_local_controller(codec):
    controller = ObjectController(GRASP, SETTINGS)
    stream = ServerStream("a", setup(memory=None))
    read = msgspec.json.Decoder(CommandRecord) if codec == JSON else msgspec.msgpack.Decoder(CommandRecord)
    for i in range(20):
        command = controller.step(state(i), desired_with_joints(), EXTERNAL)
        reply = stream.command(protocol.encode(stream_state(i, seed=i).to_dict(), codec), codec)
        assert (reply.ok, reply.encoding) == (True, codec)
        record = read.decode(reply.payload)
        assert_same_step(record.unpack(GRASP), command, controller.memory)
        assert (record.sequence, record.time) == (i, 12.25)
        assert record.late == (record.server_seconds > 0.05)
    assert stream.outcomes == {"ok": 20}
    assert np.abs(controller.memory.integral).max() > 0.0  # the steps differ


def test_stream_continues_from_the_memory_of_an_earlier_one():
    """A stream that is opened again with the memory of the last command returns the commands of an uninterrupted one."""
    first = ServerStream("a", setup(memory=None))
    read = msgspec.msgpack.Decoder(CommandRecord).decode
    for i in range(5):
        last = read(first.command(protocol.encode(stream_state(i, seed=i).to_dict(), MSGPACK), MSGPACK).payload).unpack(GRASP)
    again = protocol.encode(setup(memory=last.memory).to_dict(), MSGPACK)
    second = ServerStream("a", StreamSetup.from_dict(HANDS, protocol.decode(again, MSGPACK)))
    payload = protocol.encode(stream_state(5, seed=9).to_dict(), MSGPACK)
    fresh = ServerStream("a", setup(memory=None))
    one, other, new = (read(each.command(payload, MSGPACK).payload).unpack(GRASP) for each in (first, second, fresh))
    for name in ("w", "acceleration", "joint_acceleration", "creep"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-9, atol=ROUNDING, err_msg=name)
    np.testing.assert_allclose(other.memory.integral, one.memory.integral, rtol=1e-12)
    assert np.abs(new.acceleration - one.acceleration).max() > 1e-3  # m/s², because of the integral
    # a cold start: with a cost accurate to 1e-8, the forces are accurate to the square root of that
    np.testing.assert_allclose(other.f, one.f, atol=1e-4 * np.abs(one.f).max())
    np.testing.assert_allclose(other.tau, one.tau, atol=1e-4 * np.abs(one.tau).max())


def test_skipped_states_are_counted():
    stream = ServerStream("a", setup())
    for sequence in (3, 4, 8, 9):
        assert stream.command(protocol.encode(stream_state(sequence).to_dict(), MSGPACK), MSGPACK).ok
    assert stream.skipped == 3
    assert stream.command(protocol.encode(stream_state(0).to_dict(), MSGPACK), MSGPACK).ok  # a restarted driver
    assert stream.skipped == 3


def test_command_slower_than_its_validity_is_marked_late():
    stream = ServerStream("a", setup(validity=0.05))
    payload = protocol.encode(stream_state().to_dict(), MSGPACK)
    late = stream.command(payload, MSGPACK, received=time.perf_counter() - 0.06)
    assert protocol.decode(late.payload, MSGPACK)["late"] is True
    assert protocol.decode(late.payload, MSGPACK)["server_seconds"] > 0.06


@CODECS
def test_hands_with_other_drives_get_set_points_and_a_guaranteed_margin(codec):
    """Servos take positions; the margin counts the error of their stiffness."""
    servo = Drive("position", stiffness=20.0, damping=0.1, stiffness_error=0.3)
    grasp = replace(GRASP, hand=HAND.with_drives(servo))
    law = ObjectControlLaw(grasp, SETTINGS)
    command, after = law.step(law.initial_memory(), state(), desired_with_joints(), EXTERNAL)
    record = msgspec.to_builtins(CommandRecord.pack(command, after, has_drive=True))
    remote = read_command(grasp, protocol.decode(protocol.encode(record, codec), codec))
    np.testing.assert_allclose(remote.drive.position, command.drive.position, atol=ROUNDING)
    np.testing.assert_allclose(remote.guaranteed_margin, command.guaranteed_margin, atol=ROUNDING)
    assert (remote.guaranteed_margin < remote.slip_margin).all()
    assert remote.drive.joints == tuple(joint.name for joint in HAND.joints)


def test_stream_sends_set_points_only_if_the_drives_are_not_ideal():
    for hand, is_sent in ((HAND, False), (HAND.with_drives(Drive("impedance", stiffness=2.0)), True)):
        stream = ServerStream("a", StreamSetup(replace(GRASP, hand=hand), SETTINGS))
        reply = stream.command(protocol.encode(stream_state(0).to_dict(), JSON), JSON)
        record = protocol.decode(reply.payload, JSON)
        assert ("drive" in record, "guaranteed_margin" in record) == (is_sent, is_sent)
        remote = read_command(replace(GRASP, hand=hand), record)
        np.testing.assert_allclose(remote.drive.torque, remote.tau, atol=ROUNDING)


@CODECS
def test_every_third_command_has_the_clearance_of_its_state(codec):
    settings = replace(SETTINGS, clearance_steps=3)
    stream, law = ServerStream("a", replace(setup(memory=None), settings=settings)), ObjectControlLaw(GRASP, SETTINGS)
    for i in range(7):
        reply = stream.command(protocol.encode(stream_state(i, seed=i).to_dict(), codec), codec)
        remote = read_command(GRASP, protocol.decode(reply.payload, codec))
        if i % 3:
            assert remote.clearance is None
            continue
        local = law.step(law.initial_memory(), state(i), desired_with_joints(), EXTERNAL)[0].clearance
        assert (remote.clearance.first, remote.clearance.second) == (local.first, local.second)
        assert remote.clearance.distance == pytest.approx(local.distance, abs=1e-12)
        np.testing.assert_allclose(remote.clearance.points, local.points, atol=1e-12)
