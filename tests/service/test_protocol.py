"""Codecs, envelopes and error records."""

from __future__ import annotations

import contextlib
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.service_requests import pinch

from graspforce.core.errors import ErrorReply, InvalidInput, RequestRefused, UnknownName
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import JSON, MSGPACK, Envelope

CODECS = pytest.mark.parametrize("codec", [JSON, MSGPACK])
NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**63), 2**64 - 1)
VALUES = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)


@CODECS
@given(record=VALUES)
def test_decode_inverts_encode(codec, record):
    assert protocol.decode(protocol.encode(record, codec), codec) == record


@CODECS
def test_arrays_are_encoded_as_lists(codec):
    record = {"q": np.array([[0.1, -2.5]]), "n": np.int64(7), "x": np.float64(0.3)}
    assert protocol.decode(protocol.encode(record, codec), codec) == {"q": [[0.1, -2.5]], "n": 7, "x": 0.3}


@CODECS
def test_value_without_encoding_is_rejected(codec):
    with pytest.raises(InvalidInput, match="a record of plain values"):
        protocol.encode({"q": object()}, codec)


@CODECS
@given(payload=st.binary(max_size=60))
def test_any_bytes_decode_or_are_invalid_input(codec, payload):
    with contextlib.suppress(InvalidInput):
        protocol.decode(payload, codec)


@pytest.mark.parametrize(("payload", "codec"), [(b"[" * 10**6, JSON), (b"\x91" * 10**6, MSGPACK), (b"\x81\x80\x00", MSGPACK)])
def test_undecodable_payload_is_invalid_input(payload, codec):
    with pytest.raises(InvalidInput, match=r"^input = .*: must be (JSON|MessagePack) \("):
        protocol.decode(payload, codec)


@pytest.mark.parametrize(
    ("encoding", "codec"),
    [
        (None, JSON),
        ("zenoh/bytes", JSON),
        ("application/json", JSON),
        ("application/msgpack", MSGPACK),
        ("application/msgpack;graspforce/problem/1", MSGPACK),
    ],
)
def test_encoding_selects_the_codec(encoding, codec):
    assert protocol.select_codec(encoding) == codec


@pytest.mark.parametrize("encoding", ["text/plain", "application/cbor", "json", ";json-schema;"])
def test_unknown_encoding_is_rejected_with_the_allowed_ones(encoding):
    if encoding.startswith(";"):
        assert protocol.select_codec(encoding) == JSON  # a schema without a type is no encoding
        return
    with pytest.raises(InvalidInput, match="must be application/json or application/msgpack") as caught:
        protocol.select_codec(encoding)
    assert caught.value.field == "encoding"


@given(
    sequence=st.none() | st.integers(0, protocol.LARGEST_SEQUENCE),
    budget=st.none() | st.floats(1e-9, 1e9),
    backend=st.none() | st.text(),
)
def test_split_inverts_wrap(sequence, budget, backend):
    envelope = Envelope(sequence, budget, backend)
    split, record = Envelope.split(envelope.wrap(pinch()))
    assert split == envelope
    assert record == pinch()
    assert protocol.find_sequence(envelope.wrap({})) == sequence


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("sequence", value) for value in (-1, 1.0, True, 2**63, "7")),
        *(("budget", value) for value in (0, -0.1, math.nan, math.inf, "1 s")),
        ("backend", 3),
    ],
)
def test_invalid_envelope_names_its_field(field, value):
    with pytest.raises(InvalidInput) as caught:
        Envelope.split({**pinch(), field: value})
    assert caught.value.field == field
    assert field != "sequence" or protocol.find_sequence({field: value}) is None


@CODECS
@given(message=st.text(alphabet=st.characters(), max_size=50), field=st.none() | st.text(alphabet=st.characters()))
def test_error_record_can_always_be_encoded(codec, message, field):
    for text in (message, message + "\ud800", message * 2000):
        record = protocol.error_record("invalid", text, field, 5)
        back = protocol.decode(protocol.encode(record, codec), codec)
        assert back == record
        assert back["sequence"] == 5
        assert len(back["message"]) <= 4000
    assert protocol.error_record("invalid", "μ ≥ 0", None)["message"] == "μ ≥ 0"


def test_error_record_becomes_the_exception_of_its_code():
    for code in protocol.REFUSAL_CODES:
        failure = protocol.read_error(protocol.error_record(code, "later"))
        assert isinstance(failure, RequestRefused)
        assert (failure.code, str(failure)) == (code, "later")
    for code in protocol.ERROR_CODES:
        failure = protocol.read_error(protocol.error_record(code, "w = 3: must be …", "w"))
        assert isinstance(failure, ErrorReply)
        assert (failure.code, str(failure), failure.field) == (code, "w = 3: must be …", "w")
    for nonsense in ([], {}, {"error": 7}, {"error": []}, {"error": "new"}, None):
        failure = protocol.read_error(nonsense)
        assert isinstance(failure, ErrorReply)
        assert failure.code == "internal"


@pytest.mark.parametrize("name", ["", "a/b", "*", "a$", "a?", "#", 3])
def test_hand_name_with_key_characters_is_rejected(name):
    with pytest.raises(UnknownName):
        protocol.hand_key(name)


@pytest.mark.parametrize("codec", [JSON, MSGPACK])
@given(
    sequence=st.none() | st.booleans() | st.integers(-2, 2**63) | st.text(max_size=3) | st.lists(st.integers(0, 9), max_size=2)
)
def test_sequence_is_read_without_the_other_fields(codec, sequence):
    record = {"first": [1, {"sequence": 7}], "sequence": sequence, "last": "x"}
    payload = protocol.encode(record, codec)
    assert protocol.read_sequence(payload, codec) == protocol.find_sequence(record)
    assert protocol.read_sequence(payload[:-1], codec) is None


@pytest.mark.parametrize("codec", [JSON, MSGPACK])
@given(payload=st.binary(max_size=60))
def test_random_bytes_have_at_most_a_valid_sequence(codec, payload):
    found = protocol.read_sequence(payload, codec)
    assert found is None or 0 <= found <= protocol.LARGEST_SEQUENCE
