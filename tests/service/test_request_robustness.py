"""Random and malformed requests: each gets a reply."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.request_handler import CODECS, DISTRIBUTE, HAND, HANDLER, ask, error_code, foreign_payload
from support.service_requests import distribute_request, pinch

from graspforce.core.errors import InvalidInput
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import JSON, MSGPACK

KEYS = st.sampled_from(HANDLER.keys) | st.text(max_size=20)
ENCODINGS = st.sampled_from([None, JSON, MSGPACK, "application/json;x", "text/plain"]) | st.text(max_size=20)


def check_reply(key, payload, encoding):
    """Check that a request gets an answer, or an error record other than ``internal``; return True for an answer."""
    reply = HANDLER.answer(key, payload, encoding)
    record = protocol.decode(reply.payload, reply.encoding)
    assert reply.ok == ("error" not in record)
    if not reply.ok:
        assert record["error"] in ("invalid", "unknown", "too_large"), record
        assert isinstance(record["message"], str)
    return reply.ok


@given(key=KEYS, payload=st.binary(max_size=200), encoding=ENCODINGS)
def test_random_bytes_get_a_reply(key, payload, encoding):
    check_reply(key, payload, encoding)


@CODECS
def test_truncated_request_gets_an_error(codec):
    for key, record in (("solve", pinch()), (DISTRIBUTE, distribute_request(HAND).to_dict())):
        payload = foreign_payload(record, codec)
        for end in range(0, len(payload), 1 if len(payload) < 500 else 7):
            assert not check_reply(key, payload[:end], codec)


@CODECS
def test_mutated_requests_get_a_reply(codec):
    chance = random.Random(20240613)
    originals = [
        ("solve", foreign_payload(pinch(), codec)),
        (DISTRIBUTE, foreign_payload(distribute_request(HAND).to_dict(), codec)),
    ]
    outcomes = []
    for _ in range(400):
        key, payload = chance.choice(originals)
        mutated = bytearray(payload)
        for _ in range(chance.randint(1, 4)):
            place = chance.randrange(len(mutated))
            kind = chance.randrange(4)
            if kind == 0:
                mutated[place] = chance.randrange(256)
            elif kind == 1:
                mutated[place] ^= 1 << chance.randrange(8)
            elif kind == 2:
                del mutated[place : place + chance.randint(1, 9)]
            else:
                mutated[place:place] = mutated[place : place + chance.randint(1, 9)]
            if not mutated:
                break
        outcomes.append(check_reply(key, bytes(mutated), codec))
    assert {True, False} == set(outcomes)  # some mutations leave a valid problem


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.binary(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=12,
)
PATHS = st.sampled_from(
    [(name,) for name in ("schema", "contacts", "wrench", "hand", "cone", "objective", "name", "budget", "sequence", "backend")]
    + [("contacts", 0, name) for name in ("position", "normal", "tangent", "friction", "model", "min_normal", "max_normal")]
    + [("contacts", 1), ("wrench", 2), ("contacts", 0, "position", 1), ("contacts", 1, "normal", 0)]
)


@settings(max_examples=200, deadline=None)
@given(path=PATHS, value=ANYTHING, codec=st.sampled_from([JSON, MSGPACK]))
def test_any_value_in_any_field_gets_a_reply(path, value, codec):
    record = pinch()
    inner = record
    for step in path[:-1]:
        inner = inner[step]
    inner[path[-1]] = value
    try:
        payload = foreign_payload(record, codec)
    except (InvalidInput, TypeError):  # the codec cannot encode the value
        return
    check_reply("solve", payload, codec)


@settings(max_examples=60, deadline=None)
@given(numbers=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=12, max_size=12))
def test_numbers_of_any_size_get_a_reply(numbers):
    record = pinch(wrench=numbers[:6])
    record["contacts"][0]["position"] = numbers[6:9]
    record["contacts"][1]["normal"] = numbers[9:12]
    check_reply("solve", foreign_payload(record, MSGPACK), MSGPACK)


@CODECS
@pytest.mark.parametrize("depth", [50, 900, 100_000])
def test_deep_nesting_gets_an_error(depth, codec):
    deep = b"[" * depth + b"]" * depth if codec == JSON else b"\x91" * depth + b"\x90"
    name = b'{"schema": ' if codec == JSON else b"\x81\xa6schema"
    assert not check_reply("solve", deep, codec)
    assert not check_reply("solve", name + deep + (b"}" if codec == JSON else b""), codec)


def test_extension_types_and_bytes_are_invalid_input():
    for value in (b"abc", memoryview(b"abc")):
        assert error_code("solve", pinch(wrench=value)) == "invalid"
    timestamp = b"\x81\xa6wrench\xd6\xff\x00\x00\x00\x01"
    extension = b"\x81\xa6wrench\xd4\x05\x00"
    whole_number_key = b"\x81\x07\x07"
    for payload in (timestamp, extension, whole_number_key):
        assert error_code("solve", payload) == "invalid"


def test_lone_surrogate_in_a_name_is_invalid_input():
    ok, error = ask("solve", b'{"\\ud800": 1}', JSON)
    assert not ok
    assert error["error"] == "invalid"
    assert "ud800" in error["field"]
