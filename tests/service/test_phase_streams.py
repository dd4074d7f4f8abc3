"""Streams of the phases of a grasp: the torques of Python, refusals, and safe stops."""

from __future__ import annotations

import functools
import time

import msgspec
import numpy as np
import pytest
from support.control_requests import CODECS, with_change
from support.servers import ANY_LOCAL_PORT, TIMEOUT

from graspforce.control import ControlSettings
from graspforce.control.phases.phase_controller import PhaseController
from graspforce.control.phases.phase_rules import PAUSED
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.core.errors import InvalidInput
from graspforce.estimation import Measurement, SensorModel
from graspforce.service import Client, PhaseStreamSetup, Server, Watchdog
from graspforce.service.client.phase_stream import LATE_COMMANDS
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.server.stream_registry import StreamRegistry
from graspforce.service.wire import protocol
from graspforce.service.wire.phase_records import PhaseCommandRecord, PhaseState, RemotePhaseCommand
from graspforce.service.wire.protocol import JSON, MSGPACK
from graspforce.service.wire.stream_setups import read_setup
from graspforce.simulation.cycle.plan_cycle import CycleMotion, plan_cycle
from tests.support.table_scenes import ball_scene

SENSORS = SensorModel(encoder_noise=1e-4, tip_force_noise=0.02)
PHASES = PhaseSettings(close_speed=0.05)
ROUNDING = 1e-9  # N·m: normals of the contacts are normalised again on arrival


@functools.cache
def setup(**change) -> PhaseStreamSetup:
    plan = plan_cycle(ball_scene(), PHASES, CycleMotion(optimised=False))
    return PhaseStreamSetup(plan, PHASES, SENSORS, ControlSettings(slip_margin=0.1), **change)


HANDS = {"allegro_right": ball_scene().grasp.hand}


def measurement(k: int) -> Measurement:
    """Return a measurement of period k: the hand follows the plan; then each fingertip touches."""
    plan = setup().plan
    force = 0.5 if k > 1000 else 0.0  # N
    normals = plan.grasp.contacts.R_OC[:, :, 2] @ plan.grasp.R_HO.T
    tips = np.hstack([force * normals, np.zeros((3, 3))])
    q = plan.approach(1e-3 * k).q if k < 1000 else plan.grasp.q
    return Measurement(1e-3 * k, q, tip_wrench=tips)


def send(stream: ServerStream, k: int, codec: str, stop: str = "") -> RemotePhaseCommand:
    reply = stream.command(PhaseState(k + 1, 1e-3 * k, measurement(k), stop).encode(codec), codec)
    assert reply.ok, reply.payload
    decode = msgspec.json.decode if codec == JSON else msgspec.msgpack.decode
    return RemotePhaseCommand.unpack(decode(reply.payload, type=PhaseCommandRecord), setup().hand)


@CODECS
def test_stream_returns_the_commands_of_python(codec):
    """From the approach to the squeeze, where the object controller of the touched grasp acts."""
    received = read_setup(HANDS, protocol.decode(protocol.encode(setup().to_dict(), codec), codec))
    stream, told = ServerStream("a", received), setup()
    controller = PhaseController(told.plan, told.phases, told.sensors, told.settings)
    phases = set()
    for k in range(1150):
        command, expected = send(stream, k, codec), controller.step(measurement(k))
        np.testing.assert_allclose(command.tau, expected.tau, rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(command.f_normal, expected.f_normal, rtol=0, atol=1e-6)  # N
        assert (command.phase, command.touching, command.message) == (expected.phase, expected.touching, "")
        phases.add(command.phase)
    assert phases == {"approach", "close", "squeeze"}


def test_setup_survives_the_wire():
    record = protocol.decode(protocol.encode(setup().to_dict(), JSON), JSON)
    assert read_setup(HANDS, record).to_dict() == setup().to_dict()


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        (("kind",), "phase", "kind"),
        (("hand",), "left", "hand"),
        (("plan",), ..., "plan"),
        (("plan", "gravity"), [0.0, 0.0, 0.0], "plan.gravity"),
        (("plan", "hold", "posture"), [0.0], "plan.hold.posture"),
        (("plan", "approach", "times"), [0.0, -1.0], "plan.approach.t"),
        (("phases", "close_speed"), -1.0, "phases.close_speed"),
        (("phases", "speed"), 1.0, "phases.speed"),
        (("sensors", "rate"), 0.0, "sensors.rate"),
        (("settings", "slip_margin"), "firm", "settings.slip_margin"),
        (("validity",), 0.0, "validity"),
        (("memory",), {}, "memory"),
    ],
)
def test_invalid_setups_are_named(path, value, field):
    with pytest.raises(InvalidInput) as caught:
        read_setup(HANDS, with_change(setup().to_dict(), path, value))
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"measurement": None}, "measurement"),
        ({"measurement": {"t": 0.0, "posture": [0.0]}}, "measurement.posture"),
        ({"state": {}}, "state"),
        ({"stop": 3}, "stop"),
        ({"stop": "x" * 1000}, "stop"),
        ({"sequence": -1}, "sequence"),
    ],
)
def test_invalid_states_are_named(change, field):
    record = {"sequence": 1, "time": 0.0, "measurement": measurement(0).to_dict(), **change}
    reply = ServerStream("a", setup()).command(protocol.encode(record, JSON), JSON)
    error = protocol.decode(reply.payload, JSON)
    assert (error["error"], error["field"]) == ("invalid", field)


def test_request_to_stop_holds_the_joints():
    stream = ServerStream("a", setup())
    for k in range(50):
        send(stream, k, MSGPACK)
    send(stream, 50, MSGPACK, "the arm is blocked")
    command = send(stream, 51, MSGPACK, "the arm is blocked")
    assert (command.phase, command.message) == ("stopped", "approach: the arm is blocked")


def test_silent_client_finds_the_cycle_stopped():
    stream = ServerStream("a", setup())
    for k in (*range(50), 400):
        command = send(stream, k, MSGPACK)
    assert (command.phase, command.message) == ("stopped", f"approach: {PAUSED}")


def test_open_stream_of_one_kind_is_not_opened_as_another():
    registry = StreamRegistry(HANDS, capacity=2, idle_timeout=10.0)
    record = setup().to_dict()
    assert registry.answer("a", record)["opened"]
    assert not registry.answer("a", record)["opened"]
    joints = {"kind": "joints", "hand": "allegro_right", "law": "pid", "frequency": 3.0}
    with pytest.raises(InvalidInput, match="a new id"):
        registry.answer("a", joints)


def test_client_gets_commands_and_stops_the_cycle_after_late_ones():
    """While commands are late, the watchdog acts and the base rests; the server then stops the cycle."""
    told = setup(validity=0.5)
    with (
        Server([told.hand], listen=ANY_LOCAL_PORT) as server,
        Client(server.addresses[0], timeout=TIMEOUT) as client,
        client.open_phase_stream(told, watchdog=Watchdog(step=10.0)) as stream,
    ):
        controller = PhaseController(told.plan, told.phases, told.sensors, told.settings)
        for k in range(20):
            command, expected = stream.step(measurement(k), wait=TIMEOUT), controller.step(measurement(k))
            np.testing.assert_allclose(command.tau, expected.tau, rtol=0, atol=ROUNDING)
            assert (command.phase, command.late) == ("approach", False)
        time.sleep(0.6)
        command = stream.latest()
        assert command.late
        assert not np.any(command.base.v)
        for k in range(20, 24):
            command = stream.step(measurement(k), wait=TIMEOUT)
        assert (command.phase, command.message, command.late) == ("stopped", f"approach: {LATE_COMMANDS}", False)
