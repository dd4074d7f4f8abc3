"""Streams of measurements: the server estimates the state, and continues after an interruption."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from support.control_requests import CODECS, EXTERNAL, GRASP, HAND, HANDS, desired, stream_state
from support.servers import ANY_LOCAL_PORT, TIMEOUT

from graspforce.control import ControlSettings, GraspState, ObjectControlLaw, OutputFeedbackController
from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.control.friction.friction_compensation import FrictionSettings
from graspforce.core.errors import UnknownName
from graspforce.estimation import CameraModel, Measurement, PoseMeasurement, SensorModel
from graspforce.service import Client, RequestHandler, Server, StreamSetup, StreamState
from graspforce.service.client.stream_changes import resumed_setup
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.wire.protocol import JSON, MSGPACK

SENSORS = SensorModel(encoder_noise=1e-4, tip_force_noise=0.05, camera=CameraModel(rate=100.0, latency=0.002))
SETTINGS = ControlSettings(friction=FrictionSettings())
SETUP = StreamSetup(GRASP, SETTINGS, sensors=SENSORS)
TOLERANCE = 1e-6  # N·m: forces of two solvers agree within their tolerance


def measurement(k: int) -> Measurement:
    """Return a measurement of period k, near the grasp, with a camera pose in each tenth period."""
    rng = np.random.default_rng(k)
    pose = PoseMeasurement(1e-3 * (k - 2), GRASP.p_HO + 5e-4, GRASP.R_HO, 1e-6 * np.eye(6)) if k % 10 == 5 else None
    count = len(GRASP.contacts)
    return Measurement(
        t=1e-3 * k,
        q=GRASP.q + 1e-4 * rng.standard_normal(HAND.n),
        tip_wrench=rng.standard_normal((count, 6)),
        contact_points=rng.standard_normal((count, 3)),
        object=pose,
    )


def send(stream: ServerStream, k: int, codec: str):
    """Send the measurement of period k, and return the command."""
    message = StreamState(k + 1, 1e-3 * k, measurement(k), desired(), EXTERNAL)
    reply = stream.command(message.encode(codec), codec)
    assert reply.ok, reply.payload
    decode = msgspec.json.decode if codec == JSON else msgspec.msgpack.decode
    return decode(reply.payload, type=CommandRecord).unpack(GRASP)


@CODECS
def test_stream_returns_the_commands_of_python(codec):
    stream, controller = ServerStream("a", SETUP), OutputFeedbackController(GRASP, SETTINGS, SENSORS)
    for k in range(25):
        command, expected = send(stream, k, codec), controller.step(measurement(k), desired(), EXTERNAL)
        np.testing.assert_allclose(command.tau, expected.tau, rtol=0, atol=TOLERANCE)
        np.testing.assert_allclose(command.estimate.posture, controller.estimate.q, rtol=0, atol=1e-12)  # rad
        np.testing.assert_allclose(command.estimate.fused_position, controller.estimate.fused_pose.p_HO, rtol=0, atol=1e-12)


@CODECS
def test_measurement_survives_the_wire(codec):
    sent = StreamState(3, 0.5, measurement(5), desired(), EXTERNAL)
    received = StreamState.decode(HAND, sent.encode(codec), codec)
    assert protocol.encode(received.to_dict(), JSON) == protocol.encode(sent.to_dict(), JSON)


def test_binary_measurement_equals_the_plain_one():
    plain = StreamState(3, 0.5, measurement(5), desired()).to_dict()
    binary = {**plain, "measurement": as_bytes(plain["measurement"]), "desired": as_bytes(plain["desired"])}
    received = StreamState.decode(HAND, protocol.encode(binary, MSGPACK), MSGPACK)
    assert received.binary
    assert protocol.encode(received.to_dict(), JSON) == protocol.encode(plain, JSON)


def as_bytes(value):
    """Return a record whose lists are binary arrays."""
    if isinstance(value, dict):
        return {name: as_bytes(item) for name, item in value.items()}
    return np.array(value, dtype=np.float64).tobytes() if isinstance(value, list) else value


def test_setup_survives_the_wire():
    record = msgspec.to_builtins(SETUP.to_dict(), enc_hook=lambda x: x.tolist())
    assert protocol.encode(StreamSetup.from_dict(HANDS, record).to_dict(), JSON) == protocol.encode(SETUP.to_dict(), JSON)


def test_stream_continues_from_the_last_command():
    """Another server takes over with what the last command contains: its torque stays near that without interruption."""
    first = ServerStream("a", SETUP)
    for k in range(200):
        command = send(first, k, MSGPACK)
    record = protocol.decode(protocol.encode(resumed_setup(SETUP, command).to_dict(), JSON), JSON)
    second = ServerStream("a", StreamSetup.from_dict(HANDS, record))
    interrupted, expected = send(second, 200, MSGPACK), send(first, 200, MSGPACK)
    fresh = send(ServerStream("b", SETUP), 200, MSGPACK)
    # The new filter begins with the noise of one measurement: 0.1 mrad, a twentieth of a millimetre at the object.
    assert np.abs(interrupted.tau - expected.tau).max() < 0.5 * np.abs(fresh.tau - expected.tau).max()
    np.testing.assert_allclose(interrupted.estimate.fused_position, expected.estimate.fused_position, rtol=0, atol=2e-4)  # m
    np.testing.assert_array_equal(interrupted.memory.friction.level.shape, (HAND.n,))


@pytest.mark.parametrize(
    ("sensors", "change", "field"),
    [
        (SENSORS, {"state": stream_state().to_dict()["state"], "measurement": None}, "state"),
        (None, {}, "measurement"),
        (SENSORS, {"measurement": None}, "state"),
        (SENSORS, {"state": stream_state().to_dict()["state"]}, "state"),
        (SENSORS, {"measurement": {"t": 0.0, "posture": [0.0]}}, "measurement.q"),
        (SENSORS, {"measurement": {"t": 0.0}}, "measurement.posture"),
        (SENSORS, {"measurement": {"t": "now", "posture": HAND.neutral.tolist()}}, "measurement.t"),
        (SENSORS, {"measurement": {"t": 0.0, "posture": HAND.neutral.tolist(), "object": {"t": 0.0}}}, "measurement.object"),
    ],
)
def test_invalid_measurements_are_named(sensors, change, field):
    stream = ServerStream("a", StreamSetup(GRASP, SETTINGS, sensors=sensors))
    record = {**StreamState(1, 0.0, measurement(0), desired()).to_dict(), **change}
    reply = stream.command(protocol.encode(record, JSON), JSON)
    error = protocol.decode(reply.payload, JSON)
    assert error["error"] == "invalid"
    assert error["field"].startswith(field)


@CODECS
def test_reported_slip_squeezes_in_the_same_period_and_survives_an_interruption(codec):
    """The stream acts as the local controller, also on another server that continues with the memory."""
    slipping = ContactConditions(slipping=[True] + [False] * (len(GRASP.contacts) - 1))
    stream, law = ServerStream("a", StreamSetup(GRASP)), ObjectControlLaw(GRASP, ControlSettings())
    state, memory = GraspState(GRASP.q, np.zeros(HAND.n), desired()), law.initial_memory()
    for k, conditions in enumerate([None, slipping, None]):
        expected, memory = law.step(memory, state, desired(), None, conditions)
        payload = StreamState(k + 1, 1e-3 * k, state, desired(), None, conditions).encode(codec)
        decode = msgspec.json.decode if codec == JSON else msgspec.msgpack.decode
        command = decode(stream.command(payload, codec).payload, type=CommandRecord).unpack(GRASP)
        np.testing.assert_allclose(command.tau, expected.tau, rtol=0, atol=TOLERANCE)
        stream = ServerStream("a", StreamSetup(GRASP, memory=command.memory))
    assert memory.reflex is not None
    assert command.memory.reflex.to_dict() == memory.reflex.to_dict()


def test_earlier_measurement_is_rejected_and_the_stream_goes_on():
    stream = ServerStream("a", SETUP)
    send(stream, 5, JSON)
    late = StreamState(9, 0.0, measurement(2), desired()).encode(JSON)
    error = protocol.decode(stream.command(late, JSON).payload, JSON)
    assert (error["error"], error["field"]) == ("invalid", "measurement.t")
    send(stream, 6, JSON)


def test_client_streams_measurements():
    with Server([HAND], listen=ANY_LOCAL_PORT) as server, Client(server.addresses[0], timeout=TIMEOUT) as client:
        controller = OutputFeedbackController(GRASP, SETTINGS, SENSORS)
        with client.open_stream(GRASP, SETTINGS, sensors=SENSORS, validity=TIMEOUT, torque_step=2.0) as stream:
            for k in range(10):
                command = stream.step(measurement(k), desired(), wait=TIMEOUT)
                expected = controller.step(measurement(k), desired())
                np.testing.assert_allclose(command.tau, expected.tau, rtol=0, atol=TOLERANCE)
                assert not command.late
            command = stream.step(measurement(10), desired(), lost=[GRASP.fingers[0]], wait=TIMEOUT)
            expected = controller.step(measurement(10), desired(), lost=[GRASP.fingers[0]])
            np.testing.assert_allclose(command.tau, expected.tau, rtol=0, atol=TOLERANCE)
            assert command.warnings == expected.warnings
            assert command.warnings[0].startswith(f"{GRASP.fingers[0]} has lost its drive: ")
            with pytest.raises(UnknownName, match="pinky"):
                stream.step(measurement(11), desired(), lost=["pinky"])


@CODECS
def test_a_latency_is_at_most_a_thousand_periods(codec):
    """The joint filter has a command for each period of latency: without a bound, a setup could fill the server's memory."""
    handler = RequestHandler([HAND])
    for name, latency, ok in (("a", 1e-3, True), ("b", 1.01e-3, False)):
        setup = StreamSetup(GRASP, ControlSettings(period=1e-6), sensors=SensorModel(latency=latency))
        reply = handler.answer(f"streams/{name}", protocol.encode(setup.to_dict(), codec), codec)
        record = protocol.decode(reply.payload, codec)
        assert reply.ok == ok, record
    assert (record["error"], record["field"]) == ("invalid", "sensors.latency")
    assert "must be at most 1000 periods, 0.001 s" in record["message"]
