"""States and commands in compiled code: equal to the general readers and writers, for valid and for hostile records."""

from __future__ import annotations

import hmac
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.control_requests import EXTERNAL, GRASP, HAND, SETTINGS, desired, desired_with_joints, setup, state, stream_state

from graspforce.control import ObjectController
from graspforce.core.compiled import native
from graspforce.core.errors import InvalidInput
from graspforce.service import StreamSetup, StreamState
from graspforce.service.server import plausibility, torque_step
from graspforce.service.server.plausibility import Implausible, StateGuard
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol, state_block
from graspforce.service.wire import stream_state as wire_state
from graspforce.service.wire.binary_command import BinaryCommand
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.wire.protocol import JSON, MSGPACK
from graspforce.service.wire.stream_authentication import STATE, MessageSigner

pytestmark = pytest.mark.skipif(native is None, reason="the C code was not built: no C compiler at installation")

RECORDS = [
    (joints, external, form)
    for joints in (False, True)
    for external in (False, True)
    for form in ("binary", "lists", "json", "backwards")
]
MUTATIONS = 150  # of each record
ODD_BYTES = (0x00, 0x7F, 0x80, 0x83, 0x90, 0xC0, 0xC3, 0xC4, 0xCA, 0xCB, 0xCF, 0xD3, 0xDC, 0xDF, 0xFF)


def payload_of(joints: bool, external: bool, form: str, seed: int) -> tuple[bytes, str]:
    """Return a state as a payload, and its codec."""
    motion = desired_with_joints(seed) if joints else desired(seed)
    record = StreamState(seed * 97, 1e3 + seed, state(seed), motion, EXTERNAL if external else None)
    if form == "json":
        return record.encode(JSON), JSON
    if form == "binary":
        return record.encode(MSGPACK), MSGPACK
    plain = record.to_dict()
    return protocol.encode(plain if form == "lists" else dict(reversed(plain.items())), MSGPACK), MSGPACK


def numbers_of(read: StreamState) -> list[np.ndarray]:
    """Return all arrays of a state."""
    motion = getattr(read.desired, "object", read.desired)
    joints = [read.desired.q, read.desired.v, read.desired.a] if motion is not read.desired else []
    wrench = [] if read.external is None else [read.external]
    now = read.state.object
    measured = [read.state.q, read.state.v, now.p_HO, now.R_HO, now.twist]
    return [*measured, motion.p_HO, motion.R_HO, motion.twist, motion.acceleration, *joints, *wrench]


def outcome(payload: bytes, codec: str) -> object:
    """Return what a payload is read as: the numbers of a state, or its error."""
    try:
        read = StreamState.decode(HAND, payload, codec)
    except InvalidInput as error:
        return str(error), error.field
    return read.sequence, read.time, read.binary, [array.tolist() for array in numbers_of(read)]


@pytest.mark.parametrize(("joints", "external", "form"), RECORDS)
def test_states_are_read_as_by_the_general_reader(joints, external, form):
    for seed in range(10):
        payload, codec = payload_of(joints, external, form, seed)
        fast = StreamState.decode(HAND, payload, codec)
        general = StreamState.from_dict(HAND, protocol.decode(payload, codec))
        assert (fast.sequence, fast.time, fast.binary) == (general.sequence, general.time, general.binary)
        for found, expected in zip(numbers_of(fast), numbers_of(general), strict=True):
            np.testing.assert_array_equal(found, expected)
            assert not found.flags.writeable


def test_states_as_clients_send_them_are_read_by_compiled_code():
    for joints, external, form in RECORDS:
        payload, codec = payload_of(joints, external, form, 1)
        if codec == MSGPACK:
            found = native.read_stream_state(payload, HAND.n)
            assert (found is None) == (form == "backwards")


def mutations(payload: bytes, seed: int):
    """Yield damaged payloads: bytes changed, removed, repeated and cut off."""
    rng = np.random.default_rng(seed)
    for _ in range(MUTATIONS):
        damaged = bytearray(payload)
        place = int(rng.integers(len(damaged)))
        kind = rng.integers(5)
        if kind == 0:
            damaged[place] = int(rng.choice(ODD_BYTES))
        elif kind == 1:
            damaged[place] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            del damaged[place : place + int(rng.integers(1, 9))]
        elif kind == 3:
            damaged[place:place] = damaged[place : place + int(rng.integers(1, 9))]
        else:
            del damaged[place:]
        yield bytes(damaged)


@pytest.mark.parametrize(("joints", "external", "form"), RECORDS)
def test_damaged_states_are_read_or_refused_as_without_compiled_code(joints, external, form, monkeypatch):
    payload, codec = payload_of(joints, external, form, 2)
    damaged = [payload, *mutations(payload, RECORDS.index((joints, external, form)))]
    compiled = [outcome(each, codec) for each in damaged]
    for module in (wire_state, state_block):
        monkeypatch.setattr(module, "native", None)
    assert repr([outcome(each, codec) for each in damaged]) == repr(compiled)
    assert 0 < sum(isinstance(each[0], str) for each in compiled) < len(compiled)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("time",), math.nan),
        (("time",), 3),
        (("sequence",), 2**63),
        (("sequence",), 2**63 - 1),
        (("sequence",), -1),
        (("sequence",), 1.0),
        (("state", "posture"), [math.inf] * HAND.n),
        (("state", "posture"), [True] * HAND.n),
        (("state", "posture"), [0] * HAND.n),
        (("state", "posture"), [1e308] * HAND.n),
        (("state", "posture"), np.zeros(HAND.n).tobytes()),
        (("state", "posture"), np.zeros(HAND.n - 1).tobytes()),
        (("state", "object", "rotation"), (2.0 * np.eye(3)).tolist()),
        (("state", "object", "rotation"), (-np.eye(3)).tolist()),
        (("state", "object", "rotation"), np.eye(3).ravel().tolist()),
        (("state", "object", "rotation"), [[1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
        (("state", "object", "position"), [[0.0, 0.0, 0.0]]),
        (("desired", "rotation"), (1.0 + 1e-5) * np.eye(3)),
        (("external",), None),
        (("contacts",), None),
    ],
)
def test_odd_values_are_read_or_refused_as_without_compiled_code(path, value, monkeypatch):
    record = stream_state(5).to_dict()
    inner = record
    for name in path[:-1]:
        inner = inner[name]
    inner[path[-1]] = value
    payload = protocol.encode(record, MSGPACK)
    compiled = outcome(payload, MSGPACK)
    for module in (wire_state, state_block):
        monkeypatch.setattr(module, "native", None)
    assert repr(outcome(payload, MSGPACK)) == repr(compiled)


def test_commands_are_the_bytes_of_the_general_writer():
    controller = ObjectController(GRASP, SETTINGS)
    for i in range(20):
        command = controller.step(state(i), desired_with_joints(), EXTERNAL)
        compiled, general = (
            BinaryCommand.pack(command, controller.memory),
            CommandRecord.pack(command, controller.memory, binary=True),
        )
        warnings = ("ε" * (5 * i),) * i
        for record in (compiled, general):
            record.sequence, record.time, record.late = 2 ** (3 * i), 12.0 + i, i % 2 == 0
            record.server_seconds, record.warnings = 1e-4 * (i % 3), warnings
        assert compiled.encode() == protocol.encode(general, MSGPACK)


def test_other_parts_of_a_memory_are_left_to_the_general_writer():
    controller = ObjectController(GRASP, SETTINGS)
    command = controller.step(state(), desired())
    assert BinaryCommand.pack(command, controller.memory) is not None
    assert BinaryCommand.pack(command, setup().memory) is None


@pytest.mark.parametrize("form", ["binary", "lists"])
def test_streams_answer_as_without_compiled_records(form, monkeypatch):
    """Torque steps are limited and jumps refused alike, and the commands differ in their times only."""
    sequence = [0, 1, 2, 40, 3, 4]
    payloads = [payload_of(False, False, form, seed)[0] for seed in sequence]

    def run() -> list[object]:
        stream = ServerStream("a", StreamSetup(GRASP, SETTINGS, torque_step=1e-4))
        answers = []
        for i, payload in enumerate(payloads):
            record = protocol.decode(stream.command(payload, MSGPACK, received=1e-3 * i).payload, MSGPACK)
            assert isinstance(record, dict)
            answers.append({name: value for name, value in record.items() if name not in ("server_seconds", "late")})
        return answers

    compiled = run()
    for module in (wire_state, state_block, plausibility, torque_step):
        monkeypatch.setattr(module, "native", None)
    monkeypatch.setattr(BinaryCommand, "pack", lambda command, memory: None)
    assert run() == compiled
    assert any("torque step limited" in text for each in compiled for text in each.get("warnings", ()))


def test_plausibility_is_that_of_the_rules_in_python(monkeypatch):
    rng, states = np.random.default_rng(3), []
    for seed in range(200):
        now = state(seed)
        scale = 10.0 ** rng.uniform(-4, 1)
        turn = Rotation.from_rotvec(scale * rng.standard_normal(3)).as_matrix()
        moved = type(now.object)(now.object.p_HO + 0.1 * scale * rng.standard_normal(3), turn, now.object.twist)
        states.append(type(now)(now.q + scale * rng.standard_normal(HAND.n), now.v, moved))

    def run() -> list[str]:
        guard, results = StateGuard(GRASP, 0.02), []
        for i, each in enumerate(states):
            try:
                guard.check(each, 1e-3 * i, 1e-3 * i)
                results.append("accepted")
            except Implausible as error:
                results.append(str(error))
        return results

    compiled = run()
    monkeypatch.setattr(plausibility, "native", None)
    assert run() == compiled
    assert 20 < compiled.count("accepted") < 180


def test_torque_step_ratio_is_that_of_numpy():
    rng = np.random.default_rng(1)
    for _ in range(50):
        tau, last, step = rng.standard_normal((3, 7))
        step = np.abs(step)
        assert native.torque_step_ratio(tau.tobytes(), last, step) == float((np.abs(tau - last) / step).max())
    zeros, ones = np.zeros(2), np.ones(2)
    assert native.torque_step_ratio(zeros, ones, np.full(2, np.inf)) == 0.0
    assert native.torque_step_ratio(zeros, ones, zeros) == math.inf
    assert math.isnan(native.torque_step_ratio(np.array([0.0, 5.0]), zeros, np.array([0.0, 1.0])))


def test_slip_margins_and_finite_sums_are_those_of_numpy():
    rng = np.random.default_rng(2)
    f, mu, margins = rng.standard_normal(12), rng.uniform(0.1, 1.0, 4), np.empty(4)
    native.slip_margins(f, mu, margins)
    f_t1, f_t2, f_n = f.reshape(-1, 3).T
    np.testing.assert_array_equal(margins, mu * f_n - np.hypot(f_t1, f_t2))
    assert native.has_finite_sum(f, mu)
    assert not native.has_finite_sum(f, np.array([math.nan]))
    assert not native.has_finite_sum(np.array([math.inf]), mu)


def test_authentication_codes_are_hmac_sha256():
    rng = np.random.default_rng(4)
    for size in (0, 1, 55, 64, 700, 5000):
        key, payload = rng.bytes(32), rng.bytes(size)
        attachment = MessageSigner(key, STATE).sign(payload)
        expected = hmac.digest(key, b"S" + (1).to_bytes(8, "little") + payload, "sha256")
        assert attachment == (1).to_bytes(8, "little") + expected[:16]


@pytest.mark.parametrize(
    ("function", "arguments"),
    [
        ("read_stream_state", ("text", 3)),
        ("read_stream_state", (b"", -1)),
        ("read_stream_state", (b"", 10**9)),
        ("read_stream_state", (b"",)),
        ("join_stream_state", ((b"",), ((1, 0), (1, 0)), 0)),
        ("join_stream_state", ((b"",), ((1, 0),), 4)),
        ("join_stream_state", ((b"",), ((1, -1),), 0)),
        ("join_stream_state", ((b"",), ("ab",), 0)),
        ("is_plausible_state", (np.zeros(3), None, 0.0, np.zeros((4, 4)))),
        ("is_plausible_state", (np.zeros(3), np.zeros(2), 0.0, np.zeros((4, 3)))),
        ("is_plausible_state", (np.zeros(3), None, "0", np.zeros((4, 3)))),
        ("torque_step_ratio", (np.zeros(3), np.zeros(2), np.zeros(3))),
        ("torque_step_ratio", (np.zeros(3), np.zeros(3), "text")),
        ("has_finite_sum", (np.zeros(3),)),
        ("slip_margins", (np.zeros(6), np.zeros(3), np.zeros(3))),
        ("slip_margins", (np.zeros(6), np.zeros(2), np.zeros(3))),
        ("slip_margins", (np.zeros(6), np.zeros(2), bytes(16))),
        ("write_stream_command", (b"", (), True, True, (), True, 0.0, 1, 0.0)),
        ("write_stream_command", (b"", (1,) * 16, True, True, (), True, 0.0, 1, 0.0)),
        ("write_stream_command", (b"", (b"",) * 16, True, True, (1,), True, 0.0, 1, 0.0)),
    ],
)
def test_wrong_arguments_are_refused(function, arguments):
    with pytest.raises((TypeError, ValueError, BufferError)):
        getattr(native, function)(*arguments)
