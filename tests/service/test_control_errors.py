"""Invalid and random input to control requests and streams: each gets a reply."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.control_requests import (
    BAD_GRASP,
    BAD_SETUP,
    BAD_STATE,
    BAD_STREAM_STATE,
    CODECS,
    CONTROL,
    HAND,
    HANDS,
    request,
    setup,
    stream_state,
    to_plain,
    with_change,
)
from support.request_handler import foreign_payload

from graspforce.core.errors import InvalidInput
from graspforce.service import ControlRequest, RequestHandler, ServerLimits, StreamSetup, StreamState
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import JSON, MSGPACK


def invalid_requests():
    """Return (record, key, reader, fault) of all invalid requests."""
    control, stream = request().to_dict(), setup().to_dict()
    return [
        *((control, CONTROL, lambda record: ControlRequest.from_dict(HAND, record), fault) for fault in BAD_GRASP + BAD_STATE),
        *((stream, "streams/a", lambda record: StreamSetup.from_dict(HANDS, record), fault) for fault in BAD_SETUP),
    ]


@CODECS
@pytest.mark.parametrize(("record", "key", "read", "fault"), invalid_requests())
def test_invalid_requests_and_setups_get_the_message_of_python(record, key, read, fault, codec):
    path, value, field, allowed = fault
    bad = with_change(record, path, value)
    with pytest.raises(InvalidInput) as caught:
        read(bad)
    assert caught.value.field == field
    assert caught.value.allowed.startswith(allowed)
    reply = RequestHandler([HAND]).answer(key, foreign_payload(bad, codec), codec)
    expected = {"error": caught.value.code, "message": str(caught.value), "field": field}
    assert (reply.ok, protocol.decode(reply.payload, codec)) == (False, expected)


@CODECS
@pytest.mark.parametrize(("path", "value", "field", "allowed"), BAD_STREAM_STATE)
def test_invalid_states_get_the_message_of_python_and_the_stream_continues(path, value, field, allowed, codec):
    bad = with_change(stream_state().to_dict(), path, value)
    with pytest.raises(InvalidInput) as caught:
        StreamState.from_dict(HAND, bad)
    assert caught.value.field == field
    assert caught.value.allowed.startswith(allowed)
    stream = ServerStream("a", setup())
    reply = stream.command(foreign_payload(bad, codec), codec)
    expected = {"error": "invalid", "message": str(caught.value), "field": field}
    if field != "sequence":
        expected["sequence"] = 7
    assert (reply.ok, protocol.decode(reply.payload, codec)) == (False, expected)
    assert stream.command(protocol.encode(stream_state().to_dict(), codec), codec).ok


@CODECS
@pytest.mark.parametrize(
    ("conditions", "code", "field"),
    [
        ({"lost": ["finger_1", "nope"]}, "unknown", "conditions.lost[1]"),
        ({"slipping": [True]}, "invalid", "conditions.slipping"),
        ({"friction": [0.5] * 9}, "invalid", "conditions.friction"),
    ],
)
def test_conditions_that_do_not_fit_the_contacts_are_named_with_their_path(conditions, code, field, codec):
    bad = {**stream_state().to_dict(), "conditions": conditions}
    reply = ServerStream("a", setup()).command(protocol.encode(bad, codec), codec)
    record = protocol.decode(reply.payload, codec)
    assert (record["error"], record["field"]) == (code, field)


@CODECS
def test_an_unknown_field_with_an_empty_name_is_named(codec):
    for name, field in (("", ""), ("settings", "settings.")):
        bad = {**request().to_dict(), name: {"": 1.0}}
        record = protocol.decode(RequestHandler([HAND]).answer(CONTROL, protocol.encode(bad, codec), codec).payload, codec)
        assert (record["error"], record["field"]) == ("invalid", field)


def test_large_numbers_within_their_range_get_a_command():
    """Numbers above the least of all bounds are read one by one: 2000 rad/s² are above it, and within their own."""
    given = with_change(stream_state().to_dict(), ("desired", "acceleration", 0), 2e3)
    for payload, codec in ((protocol.encode(given, JSON), JSON), (StreamState.from_dict(HAND, given).encode(MSGPACK), MSGPACK)):
        assert ServerStream("a", setup()).command(payload, codec).ok


@CODECS
@pytest.mark.parametrize(
    "error", [OverflowError("math range error"), FloatingPointError(), np.linalg.LinAlgError("Singular matrix")]
)
def test_arithmetic_that_fails_for_the_numbers_of_a_request_is_invalid(error, codec, monkeypatch, caplog):
    def fail(*args):
        raise error

    monkeypatch.setattr("graspforce.service.server.request_handler.answer_control_request", fail)
    reply = RequestHandler([HAND]).answer(CONTROL, protocol.encode(request().to_dict(), codec), codec)
    record = protocol.decode(reply.payload, codec)
    assert (reply.ok, record["error"]) == (False, "invalid")
    assert "too large or too small" in record["message"]
    assert caplog.records[-1].exc_info[1] is error


@pytest.mark.parametrize("record", [{}, {"close": False}, {"close": True, "hand": 1}, [1], None, 3.5])
def test_record_that_neither_opens_nor_closes_is_invalid_input(record):
    reply = RequestHandler([HAND]).answer("streams/a", protocol.encode(record, MSGPACK), MSGPACK)
    assert protocol.decode(reply.payload, MSGPACK)["error"] == "invalid"


def test_too_large_state_is_refused():
    reply = ServerStream("a", setup()).command(b" " * 70_000, JSON)
    assert protocol.decode(reply.payload, JSON)["error"] == "too_large"


def test_overflow_does_not_change_the_stream():
    """Finite numbers whose squares overflow are rejected, and the next state gets the same command as without them."""
    stream, other = (ServerStream("a", setup(memory=None)) for _ in range(2))
    wild = with_change(stream_state().to_dict(), ("state", "object", "position"), [1e308, -1e308, 1e308])
    reply = stream.command(protocol.encode(wild, MSGPACK), MSGPACK)
    record = protocol.decode(reply.payload, MSGPACK)
    assert not reply.ok or np.isfinite(record["torque"]).all()
    if not reply.ok:
        payload = protocol.encode(stream_state().to_dict(), MSGPACK)
        one, two = (protocol.decode(each.command(payload, MSGPACK).payload, MSGPACK)["torque"] for each in (stream, other))
        np.testing.assert_allclose(one, two, rtol=1e-6, atol=1e-9)


HANDLER = RequestHandler([HAND], limits=ServerLimits(streams=1))
STREAM = ServerStream("s", setup())


def check_reply(kind, payload, codec):
    """Check that the reply has finite torques or an error record other than ``internal``; return True for an answer."""
    if kind == "state":
        reply = STREAM.command(payload, codec)
    else:
        reply = HANDLER.answer(CONTROL if kind == "control" else "streams/a", payload, codec)
    record = protocol.decode(reply.payload, reply.encoding)
    assert reply.ok == ("error" not in record)
    if not reply.ok:
        assert record["error"] in ("invalid", "implausible", "unknown", "too_large"), record
    elif kind != "setup":
        torque = record["torque"]
        assert np.isfinite(np.frombuffer(torque) if isinstance(torque, bytes) else torque).all()
    return reply.ok


ORIGINALS = {"control": request().to_dict(), "setup": setup().to_dict(), "state": stream_state().to_dict()}
BINARY_STATE = stream_state().encode(MSGPACK)
KINDS = pytest.mark.parametrize("kind", list(ORIGINALS))


@given(kind=st.sampled_from(list(ORIGINALS)), payload=st.binary(max_size=200), codec=st.sampled_from([JSON, MSGPACK]))
def test_random_bytes_get_a_reply(kind, payload, codec):
    check_reply(kind, payload, codec)


@CODECS
@KINDS
def test_truncated_request_gets_an_error(kind, codec):
    payload = protocol.encode(ORIGINALS[kind], codec)
    for end in range(0, len(payload), 13):
        assert not check_reply(kind, payload[:end], codec)


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
        outcomes.add(check_reply(kind, bytes(mutated), codec))
        if kind == "setup":
            HANDLER.streams.close()
    assert outcomes == {True, False}  # some mutations leave a valid request


@settings(max_examples=300, deadline=None)
@given(place=st.integers(0, len(BINARY_STATE) - 1), byte=st.integers(0, 255), end=st.integers(0, len(BINARY_STATE)))
def test_mutated_binary_arrays_get_a_reply(place, byte, end):
    check_reply("state", BINARY_STATE[:place] + bytes([byte]) + BINARY_STATE[place + 1 :], MSGPACK)
    check_reply("state", BINARY_STATE[:end], MSGPACK)


def paths(value, path=()):
    """Yield the path of each value in a record."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value[:2]) if isinstance(value, list) else ()
    for name, item in items:
        yield from paths(item, (*path, name))


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)
PLACES = [(kind, path) for kind, record in ORIGINALS.items() for path in paths(to_plain(record)) if path]


@settings(max_examples=150, deadline=None)
@given(place=st.sampled_from(PLACES), value=ANYTHING, codec=st.sampled_from([JSON, MSGPACK]))
def test_any_value_in_any_place_gets_a_reply(place, value, codec):
    kind, path = place
    check_reply(kind, foreign_payload(with_change(ORIGINALS[kind], path, value), codec), codec)
    HANDLER.streams.close()


@settings(max_examples=60, deadline=None)
@given(numbers=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=15, max_size=15))
def test_numbers_of_any_size_get_a_reply(numbers):
    record = stream_state().to_dict()
    record["state"]["object"]["position"] = numbers[:3]
    record["state"]["object"]["twist"] = numbers[3:9]
    record["desired"]["twist"] = numbers[9:15]
    check_reply("state", protocol.encode(record, MSGPACK), MSGPACK)
