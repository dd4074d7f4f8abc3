"""The driver in C over the documented wire: its states and codes are those of the server, and it reads the commands."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from support.box_grasp import make_grasp
from support.c_controllers import EXAMPLES

from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspState
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.protocol import JSON, MSGPACK
from graspforce.service.wire.stream_authentication import COMMAND, STATE, MessageSigner, MessageVerifier
from graspforce.service.wire.stream_state import StreamState

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
pytestmark = pytest.mark.skipif(COMPILER is None, reason="needs a C compiler")
FLAGS = ["-std=c11", "-Wall", "-Wextra", "-Wshadow", "-Wconversion", "-Wpedantic", "-Werror", "-O1"]
SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
KEY = bytes(range(32))
GRASP = make_grasp()
NAMES = {JSON: "json", MSGPACK: "msgpack"}


@pytest.fixture(scope="module")
def driver(tmp_path_factory) -> Path:
    program = tmp_path_factory.mktemp("driver") / "wire_driver"
    command = [str(COMPILER), *FLAGS, str(EXAMPLES / "wire_driver.c"), "-o", str(program)]
    if subprocess.run([*command, *SANITIZERS], capture_output=True).returncode:  # not every compiler has sanitizers
        subprocess.run(command, check=True)
    return program


def random_state(seed: int) -> StreamState:
    rng, n = np.random.default_rng(seed), GRASP.hand.n
    q, v, twist, twist_d, a_d = (rng.normal(scale=1e-3, size=size) for size in (n, n, 6, 6, 6))
    measured = GraspState(GRASP.q + q, v, BodyMotion(GRASP.p_HO + 1e-4 * rng.normal(size=3), GRASP.R_HO, twist))
    return StreamState(1, float(rng.uniform(0.0, 100.0)), measured, BodyMotion(GRASP.p_HO, GRASP.R_HO, twist_d, a_d))


def numbers(state: StreamState) -> bytes:
    """Return what the driver reads: time, then measured and desired quantities."""
    measured, desired = state.state, state.desired
    parts = [[state.time], measured.q, measured.v, measured.object.p_HO, measured.object.R_HO, measured.object.twist]
    parts += [desired.p_HO, desired.R_HO, desired.twist, desired.acceleration]
    return np.concatenate([np.ravel(part) for part in parts]).tobytes()


def run(driver: Path, *arguments: str, given: bytes) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([str(driver), *arguments], input=given, capture_output=True, timeout=30)


@pytest.mark.parametrize("codec", [JSON, MSGPACK])
def test_states_of_the_driver_are_those_of_the_server(codec: str, driver: Path) -> None:
    for seed in range(5):
        state = random_state(seed)
        result = run(driver, "state", NAMES[codec], KEY.hex(), str(GRASP.hand.n), given=numbers(state))
        assert result.returncode == 0, result.stderr
        attachment, payload = result.stdout[:24], result.stdout[24:]
        assert MessageVerifier(KEY, STATE).accept(payload, attachment)
        assert protocol.decode(payload, codec) == protocol.decode(state.encode(codec), codec)
        if codec == MSGPACK:
            assert payload == state.encode(MSGPACK)
            assert attachment == MessageSigner(KEY, STATE).sign(payload)
        assert StreamState.decode(GRASP.hand, payload, codec).to_dict() == state.to_dict()


@pytest.mark.parametrize("codec", [JSON, MSGPACK])
@pytest.mark.parametrize("is_binary", [False, True])
def test_the_driver_reads_commands_of_the_server(codec: str, is_binary: bool, driver: Path) -> None:
    """Also lists in MessagePack, which the server sends if the state has lists."""
    state, stream = random_state(7), ServerStream("one", StreamSetup(GRASP))
    payload = state.encode(codec) if is_binary else protocol.encode(state.to_dict(), codec)
    reply = stream.command(payload, codec)
    assert reply.ok
    torque = protocol.decode(reply.payload, codec)["torque"]
    expected = np.frombuffer(torque) if isinstance(torque, bytes) else np.array(torque)
    attachment = MessageSigner(KEY, COMMAND).sign(reply.payload)
    result = run(driver, "command", NAMES[codec], KEY.hex(), given=attachment + reply.payload)
    assert result.returncode == 0, result.stdout
    found = [float(text) for text in result.stdout.split()]
    assert found[:2] == [1.0, state.time]
    np.testing.assert_array_equal(found[2:], expected)
    for forged in (MessageSigner(KEY, STATE).sign(reply.payload), attachment[:-1] + bytes([attachment[-1] ^ 1]), bytes(24)):
        assert run(driver, "command", NAMES[codec], KEY.hex(), given=forged + reply.payload).stdout == b"not genuine\n"


@pytest.mark.parametrize("codec", [JSON, MSGPACK])
def test_broken_commands_cause_no_fault(codec: str, driver: Path) -> None:
    """Cut and changed payloads with a right code: the driver ends with a verdict, also under sanitizers."""
    stream, rng = ServerStream("one", StreamSetup(GRASP)), np.random.default_rng(3)
    payload = stream.command(random_state(7).encode(codec), codec).payload
    for _ in range(40):
        broken = bytearray(payload[: rng.integers(1, len(payload))])
        for place in rng.integers(len(broken), size=4):
            broken[place] = rng.integers(256)
        message = MessageSigner(KEY, COMMAND).sign(bytes(broken)) + bytes(broken)
        assert run(driver, "command", NAMES[codec], KEY.hex(), given=message).returncode in (0, 1)
