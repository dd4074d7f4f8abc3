"""Answers of streams in one call of C equal those in Python, and are left to Python where they must be."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.control_grasps import GRASP_NAMES, named_grasp, soft_box_grasp, with_all_contact_models
from support.control_requests import GRASP, HAND

from graspforce import ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control import ContactConditions, GraspMotion, GraspState
from graspforce.core.compiled import whole_step
from graspforce.grasp.grasp import Grasp
from graspforce.hand.drives.drive import Drive
from graspforce.service import StreamSetup, StreamState
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.wire.memory_records import to_array
from graspforce.service.wire.protocol import JSON, MSGPACK

pytestmark = pytest.mark.skipif(whole_step is None, reason="the C code was not built: no C compiler at installation")

PERIOD = 1e-3  # s
LIMITED = "torque step limited to 1/"
# Both solve to 1e-9 relative to the size of the problem. After an answer in Python their warm starts may differ, and so do two
# optima that are not unique: by the square root of the tolerance.
FORCES, TORQUES = 1e-4, 1e-5  # N, and N·m at a lever of 0.1 m
NUMBERS = 5 * HAND.n + 48  # of a state with all fields
READERS = {MSGPACK: msgspec.msgpack.Decoder(CommandRecord).decode, JSON: msgspec.json.Decoder(CommandRecord).decode}


class Pair:
    """Two streams of one grasp that get the same states: one may answer in C, the other answers in Python.

    Attributes:
        compiled: number of answers in C.
    """

    def __init__(self, grasp: Grasp, **parameters: object) -> None:
        parameters.setdefault("authenticated", False)
        self.streams = [ServerStream("a", StreamSetup(grasp, **parameters)) for _ in range(2)]
        self.streams[1]._answers = None
        self.compiled, answer = 0, self.streams[0]._answers.answer

        def counted(*arguments):
            found = answer(*arguments)
            self.compiled += found is not None
            return found

        self.streams[0]._answers.answer = counted

    def give(self, payload: bytes, time: float, codec: str = MSGPACK) -> dict:
        """Give both a state; check that the answers are equal, and return that in Python."""
        found, expected = (stream.command(payload, codec, time) for stream in self.streams)
        assert (found.ok, found.encoding) == (expected.ok, expected.encoding)
        for name in ("outcomes", "skipped", "late", "last_received"):
            assert getattr(self.streams[0], name) == getattr(self.streams[1], name), name
        assert len(self.streams[0].latency) == len(self.streams[1].latency)
        record = protocol.decode(expected.payload, codec)
        if expected.ok:
            assert_equal_commands(*(READERS[codec](each.payload) for each in (found, expected)))
        else:
            assert protocol.decode(found.payload, codec) == record
        return record

    def compare_memories(self) -> None:
        """Check that both streams continue from the same memory."""
        self.streams[0]._answers._return_memory()
        found, expected = self.streams
        assert found._guard.last[1:] == expected._guard.last[1:]
        np.testing.assert_array_equal(found._guard.last[0], expected._guard.last[0])
        np.testing.assert_allclose(*(to_array(each._torque_step.last) for each in self.streams), rtol=0.0, atol=TORQUES)
        one, other = (each._control._control.memory for each in self.streams)
        for name in ("integral", "R_OC", "creep", "f"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0.0, atol=FORCES, err_msg=name)


def assert_equal_commands(found: CommandRecord, expected: CommandRecord) -> None:
    for name in ("sequence", "time", "saturated", "held", "late", "uncontrollable", "borne"):
        assert getattr(found, name) == getattr(expected, name), name
    assert_equal_warnings(found.warnings, expected.warnings)
    tolerances = {"torque": TORQUES, "force": FORCES, "slip_margin": FORCES}
    for name in ("positions", "wrench", "acceleration", "joint_acceleration", "pose_error"):
        tolerances[name] = 1e-9
    for name, tolerance in tolerances.items():
        one, other = (to_array(getattr(each, name)) for each in (found, expected))
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=tolerance, err_msg=name)
    for name, tolerance in {"integral": 1e-11, "frames": 1e-11, "creep": 1e-11, "force": FORCES}.items():
        one, other = (to_array(getattr(each.memory, name)) for each in (found, expected))
        np.testing.assert_allclose(one, other, rtol=0.0, atol=tolerance, err_msg=name)
    for name in ("tips", "tip_frames", "positions"):
        one, other = (to_array(getattr(each.memory.touched, name)) for each in (found, expected))
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12, err_msg=name)


def assert_equal_warnings(found: tuple[str, ...], expected: tuple[str, ...]) -> None:
    """Check the texts. The ratio of a limited torque step may differ in its last digit, because the torques do."""
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        if one.startswith(LIMITED):
            assert other.startswith(LIMITED)
            one, other = (each.removeprefix(LIMITED).partition(" ") for each in (one, other))
            assert one[1:] == other[1:]
            assert float(one[0]) == pytest.approx(float(other[0]), rel=0.01)
        else:
            assert one == other


def moving_state(grasp: Grasp, i: int, rng: np.random.Generator, full: bool | None = None, noise: float = 1e-5) -> StreamState:
    """Return a state of a slow motion with sensor noise; with desired joints and an external wrench if it is full.

    With the default of the noise, m and rad, no contact seems to slip.
    """
    n = grasp.hand.n
    full = i % 3 == 1 if full is None else full
    body = BodyMotion(grasp.p_HO, grasp.R_HO, acceleration=[0.0, 0.0, 0.1 * math.sin(0.1 * i), 0.0, 0.0, 0.0])
    measured = BodyMotion(grasp.p_HO + noise * rng.normal(size=3), grasp.R_HO, 1e-3 * rng.normal(size=6))
    state = GraspState(grasp.q + noise * rng.normal(size=n), 1e-2 * rng.normal(size=n), measured)
    joints = GraspMotion(body, grasp.q + 1e-3 * rng.normal(size=n), 0.1 * rng.normal(size=n), rng.normal(size=n))
    external = 0.02 * np.array([1.0, 1.0, 1.0, 0.01, 0.01, 0.01]) * rng.normal(size=6)
    return StreamState(i, PERIOD * i, state, joints if full else body, external if full or i % 4 == 2 else None)


@pytest.mark.parametrize("name", GRASP_NAMES)
def test_answers_in_c_equal_those_in_python(name: str) -> None:
    grasp, rng = named_grasp(name), np.random.default_rng(3)
    pair, usual = Pair(grasp), 0
    for i in range(60):
        record = pair.give(moving_state(grasp, i, rng).encode(MSGPACK), PERIOD * i)
        usual += not (record["warnings"] or record["uncontrollable"] or record["held"])
    has_step = pair.streams[0]._control._control.law._whole_step is not None
    assert pair.compiled > 0 or not has_step or usual < 20 or not grasp.hand.drives.is_ideal


def test_nearly_all_states_of_a_held_object_are_answered_in_c() -> None:
    pair, rng = Pair(GRASP), np.random.default_rng(1)
    for i in range(100):
        pair.give(moving_state(GRASP, i, rng).encode(MSGPACK), PERIOD * i)
    assert pair.compiled >= 98  # not the first, whose control has no memory, nor the one after


@pytest.mark.parametrize("name", ["four_finger sphere", "allegro_right sphere"])
@pytest.mark.parametrize(("codec", "binary"), [(MSGPACK, True), (MSGPACK, False), (JSON, False)])
def test_commands_in_c_have_the_bytes_of_the_general_encoder(name: str, codec: str, binary: bool) -> None:
    grasp, rng = named_grasp(name), np.random.default_rng(9)
    pair = Pair(grasp)
    for i in range(20):
        state = moving_state(grasp, i, rng)
        payload = state.encode(codec) if binary else protocol.encode(state.to_dict(), codec)
        command = pair.streams[0].command(payload, codec, PERIOD * i).payload
        record = READERS[codec](command)
        assert isinstance(record.torque, bytes) == isinstance(record.memory.frames, bytes) == binary
        assert protocol.encode(record, codec) == command
    assert pair.compiled > 10


def test_contacts_without_friction_have_the_margins_of_python() -> None:
    grasp = named_grasp("allegro_right box")
    contacts = [replace(each, model="frictionless", friction=None) for each in grasp.contacts.contacts[:1]]
    grasp = replace(grasp, contacts=ContactSet.stack([*contacts, *grasp.contacts.contacts[1:]]))
    pair, rng = Pair(grasp), np.random.default_rng(4)
    for i in range(40):
        pair.give(moving_state(grasp, i, rng).encode(MSGPACK), PERIOD * i)
    assert pair.compiled > 0


@pytest.mark.parametrize("grasp", [soft_box_grasp(), with_all_contact_models(named_grasp("dlr_hit2 sphere"), 3)])
def test_soft_contacts_are_answered_in_python(grasp: Grasp) -> None:
    pair, rng = Pair(grasp), np.random.default_rng(5)
    for i in range(20):
        pair.give(moving_state(grasp, i, rng).encode(MSGPACK), PERIOD * i)
    assert pair.compiled == 0


def odd_payload(kind: int, i: int, rng: np.random.Generator) -> tuple[bytes, str]:
    """Return a state that C leaves to Python, and its encoding."""
    state = moving_state(GRASP, i, rng)
    assert isinstance(state.state, GraspState)
    if kind == 0:
        return protocol.encode(state.to_dict() | {"unknown": 1}, JSON), JSON
    if kind > 8:
        contacts = {"number": 1, "release": ["nobody"], "force_rate": 10**20}
        wrong = ({"sequence": 2**64}, {"sequence": -(2**63) - 1}, {"conditions": {"friction": [2**64]}}, {"contacts": contacts})
        return json.dumps(state.to_dict() | wrong[kind - 9]).encode(), JSON
    if kind == 1:
        return protocol.encode(dict(reversed(state.to_dict().items())), MSGPACK), MSGPACK
    if kind == 2:
        return protocol.encode(state.to_dict() | {"unknown": 1}, MSGPACK), MSGPACK
    if kind == 3:
        state = msgspec.structs.replace(state, conditions=ContactConditions(slipping=np.array([True, False, False])))
    elif kind == 4:  # a jump
        state = msgspec.structs.replace(state, state=replace(state.state, q=GRASP.q + 0.3))
    elif kind == 5:  # a jump of a joint to its limit
        q = np.where(np.arange(HAND.n) == 2, HAND.q_upper[2], GRASP.q)
        state = msgspec.structs.replace(state, state=replace(state.state, q=q))
    elif kind == 6:  # more than the motors can do
        body = BodyMotion(GRASP.p_HO, GRASP.R_HO, acceleration=[0.0, 0.0, 500.0, 0.0, 0.0, 0.0])
        state = msgspec.structs.replace(state, desired=body)
    elif kind == 7:
        state = msgspec.structs.replace(state, desired=BodyMotion([0.0, 0.0, 3.0], GRASP.R_HO))
    payload = state.encode(MSGPACK)
    return (payload if kind < 8 else payload[: rng.integers(len(payload))]), MSGPACK


@settings(max_examples=30)
@given(kinds=st.lists(st.integers(0, 12), max_size=12), seed=st.integers(0, 2**16), gap=st.integers(1, 15))
def test_memory_is_handed_over_at_each_odd_state(kinds: list[int], seed: int, gap: int) -> None:
    pair, rng, i = Pair(GRASP), np.random.default_rng(seed), 0
    for kind in kinds:
        for _ in range(gap):
            pair.give(moving_state(GRASP, i, rng).encode(MSGPACK), PERIOD * i)
            i += 1
        pair.give(*((payload := odd_payload(kind, i, rng))[0], PERIOD * i, payload[1]))
        i += 1
    for _ in range(20):
        pair.give(moving_state(GRASP, i, rng).encode(MSGPACK), PERIOD * i)
        i += 1
    pair.compare_memories()


@settings(max_examples=200)
@given(
    index=st.integers(0, NUMBERS - 1),
    factor=st.sampled_from([0.0, 0.5, 0.999, 1.001, 3.0, -3.0, 1e6, 1e13, -1e300, math.nan]),
)
def test_one_wrong_number_has_the_outcome_of_python(index: int, factor: float) -> None:
    """A number of the block is moved by a multiple of its largest change, or of half its range."""
    pair, rng = Pair(GRASP), np.random.default_rng(0)
    for i in range(4):
        pair.give(moving_state(GRASP, i, rng, full=True).encode(MSGPACK), PERIOD * i)
    rules = pair.streams[0]._answers._rules
    usual = moving_state(GRASP, 4, rng, full=True)
    payload = usual.encode(MSGPACK)
    for rule in (rules[1, index], rules[2, index] + 1e-3 * rules[3, index], 1.0):
        if math.isfinite(rule):
            pair.give(with_number(payload, usual, index, factor * rule), PERIOD * 4)


def with_number(payload: bytes, state: StreamState, index: int, change: float) -> bytes:
    """Return the payload of a full state with a change of one of its numbers, in their order in the payload."""
    assert isinstance(state.state, GraspState)
    assert isinstance(state.desired, GraspMotion)
    assert state.external is not None
    now, body = state.state.object, state.desired.object
    parts = (
        *(state.state.q, state.state.v, now.p_HO, now.R_HO, now.twist),
        *(body.p_HO, body.R_HO, body.twist, body.acceleration),
        *(state.desired.q, state.desired.v, state.desired.a, state.external),
    )
    at = 0
    for part in parts:
        numbers = np.ascontiguousarray(part).ravel()
        at = payload.index(numbers.tobytes(), at)
        if index < len(numbers):
            changed = numbers.copy()
            changed[index] += change
            return payload[:at] + changed.tobytes() + payload[at + changed.nbytes :]
        at, index = at + numbers.nbytes, index - len(numbers)
    raise AssertionError("index is out of range")


def test_torque_steps_above_the_bound_are_limited_as_in_python() -> None:
    pair, rng, limited = Pair(GRASP, torque_step=0.01), np.random.default_rng(2), 0
    for i in range(60):
        state = moving_state(GRASP, i, rng)
        if i % 20 == 15:
            body = BodyMotion(GRASP.p_HO, GRASP.R_HO, acceleration=[0.0, 0.0, 4.0, 0.0, 0.0, 0.0])
            state = msgspec.structs.replace(state, desired=body)
        limited += any("torque step" in each for each in pair.give(state.encode(MSGPACK), PERIOD * i)["warnings"])
    assert limited > 0
    assert pair.compiled >= 58
    pair.compare_memories()


def test_a_change_with_a_giant_integer_begins_as_in_python() -> None:
    """MessagePack has no integers above 64 bits."""
    pair, rng = Pair(GRASP), np.random.default_rng(2)
    change = {"number": 1, "release": [GRASP.fingers[-1]], "force_rate": 10**20}
    for i in range(20):
        pair.give(protocol.encode(moving_state(GRASP, i, rng).to_dict(), JSON), PERIOD * i, JSON)
    reply = pair.streams[0].command(json.dumps(moving_state(GRASP, 20, rng).to_dict() | {"contacts": change}).encode(), JSON)
    assert reply.ok, reply.payload
    assert pair.streams[0]._control._changes.is_used


@pytest.mark.parametrize("codec", [MSGPACK, JSON])
@pytest.mark.parametrize(
    ("noise", "is_at_limit", "warnings"),
    [
        (3e-4, False, {"slips"}),
        (1e-3, False, {"slips", "has lost contact"}),
        (1e-5, True, {"has lost contact", "is at its position limit"}),
    ],
)
def test_states_with_warnings_are_answered_in_c(codec: str, noise: float, is_at_limit: bool, warnings: set[str]) -> None:
    """`give` compares the texts."""
    pair, rng, found = Pair(GRASP), np.random.default_rng(8), set()
    q = np.where(np.arange(HAND.n) == 2, HAND.q_upper, GRASP.q)
    for i in range(60):
        state = moving_state(GRASP, i, rng, noise=noise)
        if is_at_limit:
            state = msgspec.structs.replace(state, state=replace(state.state, q=q))
        payload = protocol.encode(state.to_dict(), JSON) if codec == JSON else state.encode(codec)
        found.update(each.partition(":")[0].partition(" ")[2] for each in pair.give(payload, PERIOD * i, codec)["warnings"])
    assert found == warnings
    assert pair.compiled >= 58
    pair.compare_memories()


def test_implausible_states_leave_the_start_of_the_solver() -> None:
    """C attempts these states in vain; the next command is that of a stream which answers in Python, to rounding."""
    pair, rng = Pair(GRASP), np.random.default_rng(8)
    q = np.where(np.arange(HAND.n) == 2, HAND.q_upper[2], GRASP.q)  # a jump
    for i in range(60):
        state = moving_state(GRASP, i, rng)
        if i % 20 == 13:
            state = msgspec.structs.replace(state, state=replace(state.state, q=q))
        pair.give(state.encode(MSGPACK), PERIOD * i)
        one, other = (to_array(each._torque_step.last) for each in pair.streams)
        if pair.streams[0]._answers._memory is None:
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
    assert pair.compiled > 20


def test_skipped_and_late_states_are_counted() -> None:
    pair, rng = Pair(GRASP, validity=0.2), np.random.default_rng(2)
    stream = pair.streams[0]
    for i in range(10):
        reply = stream.command(moving_state(GRASP, 3 * i, rng).encode(MSGPACK), MSGPACK)
        assert not protocol.decode(reply.payload, MSGPACK)["late"]
    assert (stream.skipped, stream.late, len(stream.latency)) == (18, 0, 10)
    early = -1.0  # s, before the clock began
    record = protocol.decode(stream.command(moving_state(GRASP, 30, rng).encode(MSGPACK), MSGPACK, early).payload, MSGPACK)
    assert record["late"]
    assert record["server_seconds"] > 0.2
    assert (stream.late, stream.skipped) == (1, 20)
    assert pair.compiled >= 9


@pytest.mark.parametrize("drive", [Drive("current", torque_constant=1.0, torque_error=0.1), Drive("position", stiffness=20.0)])
def test_drives_get_their_set_points_from_python(drive: Drive) -> None:
    grasp, rng = replace(GRASP, hand=HAND.with_drives(drive)), np.random.default_rng(0)
    pair = Pair(grasp)
    for i in range(20):
        record = pair.give(moving_state(grasp, i, rng).encode(MSGPACK), PERIOD * i)
        assert record["drive"] is not None
    assert pair.compiled == 0


def test_a_stream_goes_on_after_its_memory_was_handed_over() -> None:
    """The integral and the sliding of many answers in C are those from which Python continues."""
    pair, rng = Pair(GRASP), np.random.default_rng(7)
    for i in range(200):
        record = moving_state(GRASP, i, rng).to_dict()
        codec = JSON if i % 3 == 0 else MSGPACK
        if i % 40 == 39:
            codec, record = MSGPACK, dict(reversed(record.items()))  # not in the order of docs/wire.md
        pair.give(protocol.encode(record, codec), PERIOD * i, codec)
    assert 140 < pair.compiled < 160
