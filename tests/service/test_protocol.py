"""Bytes and records: what goes over the wire comes back, and what cannot be read is said to be so."""

from __future__ import annotations

import contextlib
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.service_requests import distribute_request, pinch

from graspforce.contact.contact import Contact
from graspforce.core.errors import ErrorReply, InvalidInput, RequestRefused, UnknownName
from graspforce.force.problem import Cone, Objective
from graspforce.hand.hand import Hand
from graspforce.service import DistributeRequest, ServerStatus
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
def test_what_is_encoded_comes_back(codec, record):
    assert protocol.decode(protocol.encode(record, codec), codec) == record


@CODECS
def test_arrays_go_as_plain_lists(codec):
    record = {"q": np.array([[0.1, -2.5]]), "n": np.int64(7), "x": np.float64(0.3)}
    assert protocol.decode(protocol.encode(record, codec), codec) == {"q": [[0.1, -2.5]], "n": 7, "x": 0.3}


@CODECS
def test_what_no_codec_can_say_is_refused(codec):
    with pytest.raises(InvalidInput, match="a record of plain values"):
        protocol.encode({"q": object()}, codec)


@CODECS
@given(payload=st.binary(max_size=60))
def test_any_bytes_are_a_value_or_bad_input(codec, payload):
    with contextlib.suppress(InvalidInput):
        protocol.decode(payload, codec)


@pytest.mark.parametrize(("payload", "codec"), [(b"[" * 10**6, JSON), (b"\x91" * 10**6, MSGPACK), (b"\x81\x80\x00", MSGPACK)])
def test_what_no_decoder_can_hold_is_bad_input(payload, codec):
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
def test_the_encoding_picks_the_codec(encoding, codec):
    assert protocol.select_codec(encoding) == codec


@pytest.mark.parametrize("encoding", ["text/plain", "application/cbor", "json", ";json-schema;"])
def test_another_encoding_is_named_with_those_allowed(encoding):
    if encoding.startswith(";"):
        assert protocol.select_codec(encoding) == JSON  # a schema without a type names no encoding
        return
    with pytest.raises(InvalidInput, match="must be application/json or application/msgpack") as caught:
        protocol.select_codec(encoding)
    assert caught.value.field == "encoding"


@given(
    sequence=st.none() | st.integers(0, protocol.LARGEST_SEQUENCE),
    budget=st.none() | st.floats(1e-9, 1e9),
    backend=st.none() | st.text(),
)
def test_an_envelope_comes_off_as_it_was_put_on(sequence, budget, backend):
    envelope = Envelope(sequence, budget, backend)
    off, record = Envelope.split(envelope.wrap(pinch()))
    assert off == envelope
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
def test_a_bad_envelope_is_named(field, value):
    with pytest.raises(InvalidInput) as caught:
        Envelope.split({**pinch(), field: value})
    assert caught.value.field == field
    assert field != "sequence" or protocol.find_sequence({field: value}) is None


@CODECS
@given(message=st.text(alphabet=st.characters(), max_size=50), field=st.none() | st.text(alphabet=st.characters()))
def test_an_error_record_can_always_be_sent_and_read(codec, message, field):
    for text in (message, message + "\ud800", message * 2000):
        record = protocol.error_record("invalid", text, field, 5)
        back = protocol.decode(protocol.encode(record, codec), codec)
        assert back == record
        assert back["sequence"] == 5
        assert len(back["message"]) <= 4000
    assert protocol.error_record("invalid", "μ ≥ 0", None)["message"] == "μ ≥ 0"


def test_an_error_record_is_raised_as_what_it_is():
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
def test_a_hand_that_could_be_another_key_has_no_key(name):
    with pytest.raises(UnknownName):
        protocol.hand_key(name)


@pytest.fixture(scope="module")
def request_record():
    return {**distribute_request(Hand.load("four_finger")).to_dict(), "gravity": [0.0, 9.81, 0.0], "velocity": [0.1] * 12}


def test_a_request_to_distribute_comes_back(request_record):
    cone, objective = Cone("pyramid", 5, "outer"), Objective("sum_normal")
    for change in ({}, {"acceleration": [0.2] * 12, "cone": cone.to_dict(), "objective": objective.to_dict()}):
        record = {**request_record, **change}
        request = DistributeRequest.from_dict(record)
        back = request.to_dict()
        for was, now in zip(record["contacts"], back.pop("contacts"), strict=True):
            assert now["finger"] == was["finger"]
            for axis in ("position", "normal", "tangent"):  # what is normalised again moves by rounding
                np.testing.assert_allclose(now[axis], was[axis], rtol=0, atol=1e-15)
        assert back == {name: value for name, value in record.items() if name != "contacts"}
    assert (request.cone, request.objective) == (cone, objective)


@given(quaternion=st.tuples(*[st.floats(-2.0, 2.0)] * 4).filter(lambda q: max(map(abs, q)) > 1e-150))
def test_a_quaternion_says_the_same_as_its_rotation_matrix(request_record, quaternion):
    w, *xyz = np.array(quaternion) / max(map(abs, quaternion))
    body = {"position": request_record["object"]["position"], "quaternion": list(quaternion)}
    request = DistributeRequest.from_dict({**request_record, "object": body})
    # a second way: R = 1 + 2 w S + 2 S², S = S(xyz), of the unit quaternion
    w, xyz = w / math.hypot(w, *xyz), np.array(xyz) / math.hypot(w, *xyz)
    S = np.array([[0, -xyz[2], xyz[1]], [xyz[2], 0, -xyz[0]], [-xyz[1], xyz[0], 0]])
    np.testing.assert_allclose(request.R_HO, np.eye(3) + 2 * w * S + 2 * S @ S, atol=1e-14)  # rounding of a few products


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"posture": None}, "posture"),
        ({"posture": [0.1, math.nan]}, "posture[1]"),
        ({"object": 3}, "object"),
        ({"object": {"position": [0, 0, 0]}}, "object"),
        ({"object": {"position": [0, 0], "quaternion": [1, 0, 0, 0]}}, "object.position"),
        ({"object": {"position": [0, 0, 0], "quaternion": [0, 0, 0, 0]}}, "object.quaternion"),
        ({"object": {"position": [0, 0, 0], "rotation": np.diag([1, 1, -1]).tolist()}}, "object.rotation"),
        ({"object": {"position": [0, 0, 0], "rotation": np.full((3, 3), 1e300).tolist()}}, "object.rotation"),
        ({"object": {"position": [0, 0, 0], "rotation": [[1, 0, 0], [0, 1, 1e-4], [0, 0, 1]]}}, "object.rotation"),
        ({"contacts": []}, "contacts"),
        ({"contacts": [5]}, "contacts[0]"),
        ({"contacts": [{"position": [0, 0, 0], "normal": [0, 0, 1], "friction": 1}]}, "contacts[0].finger"),
        ({"contacts": [{"position": [0, 0, 0], "normal": [0, 0, 1], "friction": 1, "finger": 2}]}, "contacts[0].finger"),
        ({"contacts": [{"position": [0, 0, 0], "normal": [0, 0, 1], "friction": -1, "finger": "a"}]}, "contacts[0].friction"),
        ({"contacts": [{"position": [0, 0, 0], "normal": [0, 0, 1], "tip": 1, "finger": "a"}]}, "contacts[0].tip"),
        ({"wrench": [1]}, "wrench"),
        ({"gravity": [0, -9.81]}, "gravity"),
        ({"velocity": "fast"}, "velocity"),
        ({"acceleration": [math.inf]}, "acceleration[0]"),
        ({"cone": {"type": "pyramid", "side": "left"}}, "cone.side"),
        ({"objective": {"type": "power"}}, "objective.type"),
        ({"torques": []}, "torques"),
    ],
)
def test_a_bad_request_to_distribute_names_its_field(request_record, change, field):
    with pytest.raises(InvalidInput) as caught:
        DistributeRequest.from_dict({**request_record, **change})
    assert caught.value.field == field


def test_contacts_and_fingers_go_in_pairs():
    contact = Contact([0, 0, 0], [0, 0, 1], friction=0.5)
    with pytest.raises(InvalidInput, match="one finger for each of 1 contacts"):
        DistributeRequest([0.0], (contact,), ("a", "b"), [0, 0, 0], np.eye(3), [0.0] * 6)


def test_the_rotation_of_a_request_is_one_to_within_rounding():
    R = Rotation.from_rotvec([0.4, 0.1, -0.7]).as_matrix().round(7)  # as a person would write it
    contact = Contact([0, 0, 0], [0, 0, 1], friction=0.5)
    np.testing.assert_array_equal(DistributeRequest([0.0], (contact,), ("a",), [0, 0, 0], R, [0.0] * 6).R_HO, R)


def test_a_status_comes_back():
    latency = {"count": 3, "p50": 0.1, "p99": 0.2, "max": 0.3}
    status = ServerStatus("1.2", "abc", 5.5, ("left", "right"), 2, 4, 1, {"solve": {"ok": 3, "invalid": 1}}, latency)
    for codec in (JSON, MSGPACK):
        assert ServerStatus.from_dict(protocol.decode(protocol.encode(status.to_dict(), codec), codec)) == status
