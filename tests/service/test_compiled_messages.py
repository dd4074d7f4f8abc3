"""Messages of streams that compiled code writes and reads: equal to the general code, for any record and any bytes."""

from __future__ import annotations

import hmac
import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.control_requests import EXTERNAL, GRASP, HAND, SETTINGS, desired, desired_with_joints, setup, state
from support.local_server import LocalServer

from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspMotion, GraspState, ObjectController
from graspforce.core.compiled import native
from graspforce.core.errors import InvalidInput
from graspforce.core.records import unchecked_constructor
from graspforce.service import Stream, StreamState, Watchdog
from graspforce.service.client.command_stream import StreamLink
from graspforce.service.wire import binary_command, binary_state, protocol, stream_authentication
from graspforce.service.wire.binary_command import read_binary_command
from graspforce.service.wire.binary_state import write_state
from graspforce.service.wire.command_records import CommandRecord, RemoteCommand
from graspforce.service.wire.memory_records import ControlMemoryRecord, TipContactRecord
from graspforce.service.wire.protocol import MSGPACK
from graspforce.service.wire.stream_authentication import STATE, MessageSigner, MessageVerifier

pytestmark = pytest.mark.skipif(native is None, reason="the C code was not built: no C compiler at installation")

N, K, COUNT = HAND.n, GRASP.contacts.size, len(GRASP.contacts)
ODD_BYTES = st.sampled_from([0x00, 0x7F, 0x80, 0x90, 0xC0, 0xC2, 0xC4, 0xC5, 0xCB, 0xCF, 0xD9, 0xDC, 0xDE, 0xFF])
make_motion, make_state = unchecked_constructor(BodyMotion), unchecked_constructor(GraspState)
make_grasp_motion = unchecked_constructor(GraspMotion)
sequences = st.integers(0, protocol.LARGEST_SEQUENCE)


def rows(*shape: int) -> st.SearchStrategy[np.ndarray]:
    """Return arrays of any numbers."""
    return arrays(np.float64, shape, elements=st.floats(allow_nan=True, allow_infinity=True))


def as_bytes(count: int, **limits: object) -> st.SearchStrategy[bytes]:
    """Return the bytes of arrays of `count` numbers."""
    return arrays(np.float64, count, elements=st.floats(**limits)).map(np.ndarray.tobytes)  # type: ignore[arg-type]


motions = st.builds(make_motion, rows(3), rows(3, 3), rows(6), rows(6))
states = st.builds(make_state, rows(N), rows(N), motions)
targets = motions | st.builds(make_grasp_motion, motions, rows(N), rows(N), rows(N))
memories = st.builds(
    ControlMemoryRecord,
    *(as_bytes(6), as_bytes(9 * COUNT), as_bytes(2 * COUNT), as_bytes(K)),
    st.builds(TipContactRecord, as_bytes(3 * COUNT), as_bytes(9 * COUNT), as_bytes(3 * COUNT)),
)
records = st.builds(
    CommandRecord,
    *(as_bytes(N, min_value=-1e300, max_value=1e300), as_bytes(K), as_bytes(3 * COUNT), as_bytes(6), as_bytes(6)),
    *(as_bytes(N), as_bytes(6), as_bytes(COUNT), st.integers(0, 4).flatmap(lambda m: as_bytes(6 * m)), as_bytes(6)),
    saturated=st.booleans(),
    held=st.booleans(),
    warnings=st.lists(st.text(max_size=300), max_size=20).map(tuple),
    memory=memories,
    late=st.booleans(),
    server_seconds=st.floats(1e-9, allow_nan=False),
    sequence=sequences,
    time=st.floats(allow_nan=False),
)


@given(sequence=sequences, time=st.floats(), measured=states, target=targets, external=st.none() | rows(6))
def test_states_are_the_bytes_of_the_general_writer(sequence, time, measured, target, external):
    written = write_state(N, sequence, time, measured, target, external)
    assert written == StreamState(sequence, time, measured, target, external).encode(MSGPACK)


def test_arrays_of_any_strides_are_written_by_rows():
    R, q = np.asfortranarray(state().object.R_HO), np.repeat(state().q, 2)[::2]
    turned = make_state(q, state().v, make_motion(state().object.p_HO, R, state().object.twist, np.zeros(6)))
    assert write_state(N, 1, 2.0, turned, desired(), None) == write_state(N, 1, 2.0, state(), desired(), None)


@pytest.mark.parametrize(
    "wrong", [np.zeros(N - 1), np.zeros(N + 1), np.zeros(N, np.float32), np.zeros(N, int), [0.0] * N, None]
)
def test_other_arrays_are_left_to_the_general_writer(wrong):
    assert write_state(N, 1, 0.0, make_state(wrong, state().v, state().object), desired(), None) is None
    assert write_state(N, 1, 0.0, state(), make_grasp_motion(desired(), state().q, wrong, wrong), None) is None


def read_generally(payload: bytes) -> RemoteCommand | str:
    """Return a command without compiled code, or the type of its error."""
    try:
        return msgspec.msgpack.decode(payload, type=CommandRecord).unpack(GRASP)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        return type(error).__name__


def contents(command: RemoteCommand) -> bytes:
    """Return all that a command has, in one comparable value."""
    message = command.message
    facts = [message.late, message.server_seconds, message.sequence, message.time, message.saturated, message.held]
    own = [command.tau.tobytes(), command.warnings, command.age, command.late, command.resuming, *facts]
    return msgspec.msgpack.encode([*own, message.estimate, message.contact_change, command.record])


@given(record=records)
def test_commands_are_read_as_by_the_general_reader(record):
    payload = protocol.encode(record, MSGPACK)
    found = read_binary_command(payload, GRASP)
    assert found is not None
    assert not found.tau.flags.writeable
    assert contents(found) == contents(record.unpack(GRASP)) == contents(read_generally(payload))


def command_payload() -> bytes:
    """Return a command as a server sends it."""
    controller = ObjectController(GRASP, SETTINGS)
    record = CommandRecord.pack(controller.step(state(), desired()), controller.memory, binary=True)
    record.sequence, record.time, record.server_seconds, record.warnings = 300, 12.5, 1e-4, ("slip", "ε" * 40)
    return protocol.encode(record, MSGPACK)


PAYLOAD = command_payload()
places = st.integers(0, len(PAYLOAD) - 1)


@given(places=st.lists(places, min_size=1, max_size=3), data=st.data())
def test_damaged_commands_are_never_read_otherwise(places, data):
    """What compiled code accepts, the general reader accepts with equal contents; all else is left to it."""
    changed = bytearray(PAYLOAD)
    for place in places:
        kind = data.draw(st.sampled_from(["byte", "bit", "remove", "repeat", "cut"]))
        length = data.draw(st.integers(1, 9))
        if kind == "byte" and place < len(changed):
            changed[place] = data.draw(ODD_BYTES)
        elif kind == "bit" and place < len(changed):
            changed[place] ^= 1 << (length - 1) % 8
        elif kind == "remove":
            del changed[place : place + length]
        elif kind == "repeat":
            changed[place:place] = changed[place : place + length]
        else:
            del changed[place:]
    found, general = read_binary_command(bytes(changed), GRASP), read_generally(bytes(changed))
    if found is not None:
        assert isinstance(general, RemoteCommand)
        assert contents(found) == contents(general)


@given(payload=st.binary(max_size=200))
def test_random_bytes_are_left_to_the_general_reader(payload):
    assert read_binary_command(payload, GRASP) is None
    assert native.read_stream_state(payload, N) is None


def test_each_shortened_command_and_state_is_refused():
    written = write_state(N, 7, 1.0, state(), desired_with_joints(), EXTERNAL)
    assert read_binary_command(PAYLOAD, GRASP) is not None
    assert native.read_stream_state(written, N) is not None
    assert all(read_binary_command(PAYLOAD[:end], GRASP) is None for end in range(len(PAYLOAD)))
    assert all(native.read_stream_state(written[:end], N) is None for end in range(len(written)))


@pytest.mark.parametrize(
    "change",
    [
        {"torque": np.full(N, math.nan).tobytes()},
        {"torque": np.full(N, 1e308).tobytes()},
        {"torque": np.zeros(N + 1).tobytes()},
        {"force": np.zeros(K - 1).tobytes()},
        {"uncontrollable": np.zeros(5).tobytes()},
        {"wrench": [0.0] * 6},
        {"sequence": None},
        {"guaranteed_margin": np.zeros(COUNT).tobytes()},
        {"joints": ("a",)},
    ],
)
def test_other_commands_are_left_to_the_general_reader(change):
    record = msgspec.structs.replace(msgspec.msgpack.decode(PAYLOAD, type=CommandRecord), **change)
    assert read_binary_command(protocol.encode(record, MSGPACK), GRASP) is None


def stream_outcomes() -> list[object]:
    """Return what a driver gets from a stream: torques and memory of commands, and the errors of wrong states."""
    server, outcomes = LocalServer(), []
    link = StreamLink(watchdog=Watchdog(), codec=MSGPACK, timeout=20.0, query=server.query, connect=server.connect)
    with Stream("a", setup(validity=20.0, memory=None), link) as stream:
        for i in range(4):
            command = stream.step(
                state(i), desired_with_joints() if i % 2 else desired(), EXTERNAL if i > 1 else None, wait=20.0
            )
            outcomes.append((command.sequence, command.tau.tolist(), command.memory.f.tolist(), command.f.tolist()))
            outcomes.append((command.saturated, command.forces_reused, command.estimate, str(command.contacts)))
        few = make_state(np.zeros(N - 1), np.zeros(N - 1), state().object)
        for wrong in (
            (few, desired()),
            (state(), make_grasp_motion(desired(), *np.zeros((3, N + 1)))),
            (state(), desired(), [1]),
        ):
            with pytest.raises(InvalidInput) as raised:
                stream.step(*wrong)
            outcomes.append((str(raised.value), raised.value.field, stream.sequence))
    return outcomes


def test_streams_are_the_same_without_compiled_messages(monkeypatch):
    compiled = stream_outcomes()
    for module in (binary_command, binary_state):
        monkeypatch.setattr(module, "native", None)
    assert stream_outcomes() == compiled


@given(key=st.binary(min_size=32, max_size=32), payloads=st.lists(st.binary(max_size=300), min_size=1, max_size=5))
def test_attachments_are_hmac_sha256_of_counter_and_payload(key, payloads):
    signer = MessageSigner(key, STATE)
    for number, payload in enumerate(payloads, start=1):
        counter = number.to_bytes(8, "little")
        assert signer.sign(payload) == counter + hmac.digest(key, b"S" + counter + payload, "sha256")[:16]


@given(payload=st.binary(max_size=300), attachments=st.lists(st.binary(max_size=40) | st.none(), max_size=6))
def test_messages_are_accepted_as_without_compiled_code(payload, attachments):
    """None stands for the right attachment of the next message, which is then repeated."""

    def outcomes() -> tuple[list[bool], dict[str, int]]:
        signer, verifier, accepted = MessageSigner(bytes(32), STATE), MessageVerifier(bytes(32), STATE), []
        for given_attachment in attachments:
            code = signer.sign(payload) if given_attachment is None else given_attachment
            accepted += [verifier.accept(payload, code), verifier.accept(payload, code), verifier.accept(payload + b"x", code)]
        return accepted, dict(verifier.refused)

    compiled = outcomes()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stream_authentication, "_CompiledCode", None)
        assert outcomes() == compiled


@pytest.mark.parametrize(
    ("function", "arguments"),
    [
        ("write_stream_state", ((), 3, 1, 0.0)),
        ("write_stream_state", ((b"",) * 11, 3, 1, 0.0)),
        ("write_stream_state", ((b"",) * 14, 3, 1, 0.0)),
        ("write_stream_state", ([b""] * 9, 3, 1, 0.0)),
        ("write_stream_state", ((b"",) * 9, 3, 1)),
        ("write_stream_state", ((b"",) * 9, 10**9, 1, 0.0)),
        ("write_stream_state", ((b"",) * 9, -1, 1, 0.0)),
        ("write_stream_state", ((b"",) * 9, 3, -1, 0.0)),
        ("write_stream_state", ((b"",) * 9, 3, 1, "0")),
        ("read_stream_command", ("text", 3, 3, 1)),
        ("read_stream_command", (b"", 3, 3)),
        ("read_stream_command", (b"", -1, 3, 1)),
        ("read_stream_command", (b"", 3, 10**9, 1)),
        ("read_stream_command", (b"", 3, 3, "1")),
    ],
)
def test_wrong_arguments_are_refused(function, arguments):
    with pytest.raises((TypeError, ValueError, OverflowError)):
        getattr(native, function)(*arguments)


@pytest.mark.skipif(not hasattr(native, "MessageCode"), reason="the processor has no SHA instructions")
def test_wrong_arguments_of_codes_are_refused():
    for arguments in ((), (b"",), (bytes(65), b"S"), (b"", b"SS"), ("", "S")):
        with pytest.raises((TypeError, ValueError)):
            native.MessageCode(*arguments)
    code = native.MessageCode(b"key", b"S")
    for call in (
        lambda: code.sign("text"),
        lambda: code.check(b""),
        lambda: code.check(b"", None),
        lambda: code.check("", b""),
    ):
        with pytest.raises(TypeError):
            call()
