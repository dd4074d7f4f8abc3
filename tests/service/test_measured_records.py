"""States with measurements are read by typed structs as by the general reader, which names the invalid field."""

from __future__ import annotations

import json
import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.control_requests import EXTERNAL, GRASP, HAND, desired, desired_with_joints

from graspforce.control import ContactConditions
from graspforce.core.errors import InvalidInput
from graspforce.estimation import Measurement, PoseMeasurement
from graspforce.service import StreamState
from graspforce.service.wire import protocol, state_block, stream_state
from graspforce.service.wire.protocol import JSON, MSGPACK

FORMS = ("json", "lists", "binary")
OPTIONAL = ("v", "tau", "current", "tip_wrench", "contact_points")
ODD_VALUES = (None, 0, -1, 1e7, math.nan, math.inf, 10**30, "x", "", [], {}, True, b"", b"abc", [[1.0]], [1.0, 2.0], [None])


def measured_state(present: frozenset[str], seed: int) -> StreamState:
    """Return a state with the given optional parts."""
    rng, count = np.random.default_rng(seed), len(GRASP.contacts)
    shapes = {"v": HAND.n, "tau": HAND.n, "current": HAND.n, "tip_wrench": (count, 6), "contact_points": (count, 3)}
    parts: dict[str, Any] = {name: rng.normal(size=shapes[name]) for name in OPTIONAL if name in present}
    if "object" in present:
        covariance = 1e-6 * np.eye(6) if "covariance" in present else None
        parts["object"] = PoseMeasurement(rng.normal(), GRASP.p_HO + rng.normal(size=3), GRASP.R_HO, covariance)
    measurement = Measurement(rng.normal(), GRASP.q + 0.1 * rng.normal(size=HAND.n), **parts)
    motion = desired_with_joints(seed) if "joints" in present else desired(seed)
    external = EXTERNAL if "external" in present else None
    conditions = ContactConditions(slipping=np.arange(count) == 1) if "conditions" in present else None
    return StreamState(seed, rng.normal(), measurement, motion, external, conditions)


def payload_of(state: StreamState, form: str) -> tuple[bytes, str]:
    """Return the payload of a state, and its codec."""
    if form == "lists":
        return protocol.encode(state.to_dict(), MSGPACK), MSGPACK
    codec = JSON if form == "json" else MSGPACK
    return state.encode(codec, binary=True), codec


def outcome(payload: bytes, codec: str, general: bool = False) -> object:
    """Return the plain record that a payload is read as, or its error."""
    try:
        if general:
            read = StreamState.from_dict(HAND, protocol.decode(payload, codec))
        else:
            read = StreamState.decode(HAND, payload, codec)
    except InvalidInput as error:
        return str(error), error.field
    return read.to_dict(), read.binary, read.contacts


PRESENT = st.frozensets(st.sampled_from([*OPTIONAL, "object", "covariance", "joints", "external", "conditions"]))


@settings(max_examples=200)
@given(present=PRESENT, form=st.sampled_from(FORMS), seed=st.integers(0, 100))
def test_measurements_are_read_as_by_the_general_reader(present: frozenset[str], form: str, seed: int) -> None:
    state = measured_state(present, seed)
    payload, codec = payload_of(state, form)
    found = outcome(payload, codec)
    assert found == outcome(payload, codec, general=True)
    assert found == (state.to_dict(), form == "binary", None)


@pytest.mark.parametrize("form", FORMS)
def test_measurements_need_no_general_reader(form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    payloads = [payload_of(measured_state(frozenset(present), 1), form) for present in ([], OPTIONAL, ["object", "joints"])]
    monkeypatch.setattr(StreamState, "from_dict", None)
    for payload, codec in payloads:
        read = StreamState.decode(HAND, payload, codec)
        assert isinstance(read.state, Measurement)
        assert not read.state.q.flags.writeable


def paths_of(record: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the paths of all values of a record."""
    if isinstance(record, dict):
        return [path, *(each for name, value in record.items() for each in paths_of(value, (*path, name)))]
    if isinstance(record, list):
        return [path, *(each for i, value in enumerate(record) for each in paths_of(value, (*path, i)))]
    return [path]


def with_change(record: Any, path: tuple[Any, ...], change: object) -> Any:
    """Return a record in which a value is replaced, or removed with the change `del`."""
    if not path:
        return change
    changed = dict(record) if isinstance(record, dict) else list(record)
    if len(path) == 1 and change == "del":
        del changed[path[0]]
    else:
        changed[path[0]] = with_change(record[path[0]], path[1:], change)
    return changed


@settings(max_examples=400)
@given(data=st.data(), present=PRESENT, form=st.sampled_from(FORMS))
def test_a_wrong_value_has_the_error_of_the_general_reader(data: st.DataObject, present: frozenset[str], form: str) -> None:
    payload, codec = payload_of(measured_state(present, 3), form)
    record = msgspec.json.decode(payload) if codec == JSON else msgspec.msgpack.decode(payload)
    path = data.draw(st.sampled_from(paths_of(record)[1:]))
    value = data.draw(st.sampled_from([*ODD_VALUES, "del"]))
    changed = with_change(record, path, value)
    if data.draw(st.booleans()):
        changed = {
            **changed,
            data.draw(st.sampled_from(["state", "unknown", "contacts"])): data.draw(st.sampled_from([None, {}])),
        }
    try:
        damaged = json.dumps(changed).encode() if codec == JSON else msgspec.msgpack.encode(changed)
    except (TypeError, OverflowError, ValueError):  # bytes in JSON, or a giant integer in MessagePack
        return
    found = outcome(damaged, codec)
    assert repr(found) == repr(outcome(damaged, codec, general=True))


@pytest.mark.parametrize("form", FORMS)
def test_measurements_are_read_without_compiled_code(form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    payloads = [payload_of(measured_state(frozenset((*OPTIONAL, "object", "external")), seed), form) for seed in range(5)]
    compiled = [outcome(*each) for each in payloads]
    for module in (state_block, stream_state):
        monkeypatch.setattr(module, "native", None)
    assert [outcome(*each) for each in payloads] == compiled


def test_different_numbers_of_contacts_are_refused() -> None:
    record = measured_state(frozenset(OPTIONAL), 2).to_dict()
    record["measurement"]["contact_points"].pop()
    for codec in (JSON, MSGPACK):
        text, field = outcome(protocol.encode(record, codec), codec)
        assert field == "measurement.contact_points"
        assert "3" in text or "rows" in text
