"""Streams of joint-space laws: the torques of Python, refusals, and continuation."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from support.control_requests import CODECS, HAND, HANDS, with_change
from support.servers import ANY_LOCAL_PORT, TIMEOUT

from graspforce.control.joints.force_controller import ForceController
from graspforce.control.joints.force_loop import ForceGains
from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.joints.joint_controller import JOINT_LAWS, JointController
from graspforce.core.errors import InvalidInput
from graspforce.service import Client, JointStreamSetup, Server
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.joint_records import JointCommandRecord, JointState, RemoteJointCommand
from graspforce.service.wire.protocol import JSON, MSGPACK
from graspforce.service.wire.stream_setups import read_setup

GRAVITY = [1.0, -2.0, -9.0]  # m/s²
PERIOD = 2e-3  # s
ONES = np.ones(HAND.n)
FORCE_LOOP = ForceController(HAND, ForceGains(0.5 * ONES, 20.0 * ONES, 0.01 * ONES), GRAVITY)
CONTROLLERS = [*(JointController.with_frequency(HAND, law, 3.0, GRAVITY) for law in JOINT_LAWS), FORCE_LOOP]
ALL_LAWS = pytest.mark.parametrize("controller", CONTROLLERS, ids=[*JOINT_LAWS, "force"])


def state(k: int, is_force: bool) -> JointState:
    """Return the state of period k."""
    rng = np.random.default_rng(k)
    measured = JointMotion(HAND.neutral + 0.1 * rng.standard_normal(HAND.n), rng.standard_normal(HAND.n))
    if is_force:
        return JointState(k + 1, PERIOD * k, measured, None, *(0.05 * rng.standard_normal((2, HAND.n))))
    return JointState(k + 1, PERIOD * k, measured, JointMotion(HAND.neutral, *rng.standard_normal((2, HAND.n))))


def send(stream: ServerStream, sent: JointState, codec: str = MSGPACK) -> RemoteJointCommand:
    reply = stream.command(sent.encode(codec), codec)
    assert reply.ok, reply.payload
    decode = msgspec.json.decode if codec == JSON else msgspec.msgpack.decode
    return RemoteJointCommand.unpack(decode(reply.payload, type=JointCommandRecord))


def local_torques(controller, states: list[JointState]) -> np.ndarray:
    """Return the torques of the controller in Python."""
    memory, rows = None, []
    for each in states:
        if isinstance(controller, ForceController):
            command, memory = controller.step(each.measured, each.torque, each.torque_desired, PERIOD, memory)
        else:
            command, memory = controller.step(each.measured, each.desired, PERIOD, memory)
        rows.append(command.tau)
    return np.array(rows)


@CODECS
@ALL_LAWS
def test_stream_returns_the_torques_of_python(controller, codec):
    record = protocol.decode(protocol.encode(JointStreamSetup(controller, PERIOD).to_dict(), codec), codec)
    stream = ServerStream("a", read_setup(HANDS, record))
    states = [state(k, controller is FORCE_LOOP) for k in range(20)]
    torques = [send(stream, each, codec).tau for each in states]
    np.testing.assert_allclose(torques, local_torques(controller, states), rtol=0, atol=1e-12)


@pytest.mark.parametrize("controller", CONTROLLERS[2:], ids=["pid", "force"])
def test_stream_continues_with_the_integral(controller):
    """Another server with the integral of the last command; the state is that of before, so that the error has no rate."""
    is_force, setup = controller is FORCE_LOOP, JointStreamSetup(controller, PERIOD)
    first = ServerStream("a", setup)
    for k in range(50):
        last = send(first, state(k, is_force))
    second = ServerStream("a", JointStreamSetup(controller, PERIOD, integral=last.integral))
    expected, continued = send(first, state(49, is_force)), send(second, state(49, is_force))
    np.testing.assert_allclose(continued.integral, expected.integral, rtol=0, atol=1e-12)
    assert setup.opens(JointStreamSetup(controller, PERIOD, integral=last.integral))


def test_gains_may_follow_from_a_frequency():
    record = {"kind": "joints", "hand": HAND.name, "law": "pid", "frequency": 3.0, "gravity": GRAVITY}
    expected = JointStreamSetup(CONTROLLERS[2])
    assert read_setup(HANDS, record).to_dict() == expected.to_dict()


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        (("law",), "pidd", "law"),
        (("law",), "force", "gains.kd"),
        (("gains",), ..., "gains"),
        (("frequency",), 3.0, "gains"),
        (("gains", "kp"), [1.0], "gains.kp"),
        (("gains", "kp"), [-1.0] * HAND.n, "gains.kp[0]"),
        (("gravity",), [0.0], "gravity"),
        (("period",), 0.0, "period"),
        (("integral",), [0.0], "integral"),
        (("hold",), {}, "hold"),
    ],
)
def test_invalid_setups_are_named(path, value, field):
    with pytest.raises(InvalidInput) as caught:
        read_setup(HANDS, with_change(JointStreamSetup(CONTROLLERS[2]).to_dict(), path, value))
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("controller", "path", "value", "field"),
    [
        (CONTROLLERS[0], ("measured",), ..., "measured"),
        (CONTROLLERS[0], ("measured", "posture"), [0.0], "measured.posture"),
        (CONTROLLERS[0], ("measured", "torque"), [0.0], "measured.torque"),
        (CONTROLLERS[0], ("desired", "posture"), ..., "desired.posture"),
        (CONTROLLERS[1], ("measured", "velocity"), [1e300] * HAND.n, "measured"),
        (FORCE_LOOP, ("measured", "torque"), ..., "measured.torque"),
        (FORCE_LOOP, ("desired", "torque"), [0.0], "desired.torque"),
    ],
)
def test_invalid_states_are_named(controller, path, value, field):
    sent = protocol.decode(state(0, controller is FORCE_LOOP).encode(JSON), JSON)
    reply = ServerStream("a", JointStreamSetup(controller)).command(protocol.encode(with_change(sent, path, value), JSON), JSON)
    error = protocol.decode(reply.payload, JSON)
    assert (error["error"], error["field"]) == ("invalid", field)


def test_client_streams_motions_and_forces():
    with Server([HAND], listen=ANY_LOCAL_PORT) as server, Client(server.addresses[0], timeout=TIMEOUT) as client:
        for controller in (CONTROLLERS[1], FORCE_LOOP):
            is_force = controller is FORCE_LOOP
            states = [state(k, is_force) for k in range(5)]
            with client.open_joint_stream(JointStreamSetup(controller, PERIOD, validity=TIMEOUT)) as stream:
                for each, expected in zip(states, local_torques(controller, states), strict=True):
                    if is_force:
                        command = stream.step_forces(each.measured, each.torque, each.torque_desired, wait=TIMEOUT)
                    else:
                        command = stream.step(each.measured, each.desired, wait=TIMEOUT)
                    np.testing.assert_allclose(command.tau, expected, rtol=0, atol=1e-12)
                wrong = stream.step if is_force else stream.step_forces
                with pytest.raises(InvalidInput):
                    wrong(each.measured, JointMotion(HAND.neutral) if is_force else ONES, *([] if is_force else [ONES]))
