"""The JSON Schemas of the wire: they accept every exchange of its page, and have the fields that the server reads."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterator
from functools import cache
from typing import Any

import jsonschema
import pytest
from support.control_requests import GRASP
from support.request_handler import ask
from support.servers import ANY_LOCAL_PORT, get, plain_session
from support.wire_page import page_exchanges
from support.wire_records import cases

from graspforce.core.errors import InvalidInput, UnknownField
from graspforce.service import Server
from graspforce.service.wire.schemas.catalogue import SCHEMA_NAMES, wire_schema

# Fields that are read before the others of their record: the envelope, fingers of contacts, and kinds of streams and moves.
READ_BEFORE = {"sequence", "budget", "backend", "direction", "id", "finger", "fingers", "kind", "authenticated", "proof"}
CASES = cases()
CASE = pytest.mark.parametrize("case", CASES, ids=[f"{i}-{name}" for i, (name, _, _) in enumerate(CASES)])


@cache
def validator(name: str) -> jsonschema.Draft202012Validator:
    """Return the validator of a schema."""
    return jsonschema.Draft202012Validator(wire_schema(name))


def schema_of(key: str) -> str:
    """Return the name of the schemas of a key, without request or reply."""
    top, *rest = key.split("/")
    return "/".join([top, *rest[1:]]) if top in ("hands", "streams", "setups") else key


def records(value: Any, node: Any, root: dict[str, Any], path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], str]]:
    """Yield the path of every record in a value that a schema describes, and the name of its definition."""
    if "anyOf" in node:
        definitions = {"$defs": root["$defs"]}
        fits = [each for each in node["anyOf"] if jsonschema.Draft202012Validator({**each, **definitions}).is_valid(value)]
        yield from records(value, fits[0], root, path)
    elif "$ref" in node:
        name = node["$ref"].rpartition("/")[2]
        yield from records(value, root["$defs"][name], root, path)
        yield path, name
    elif isinstance(value, list):
        for i, item in enumerate(value):
            yield from records(item, node.get("items", {}), root, (*path, i))
    elif isinstance(value, dict) and "properties" in node:
        for field, item in value.items():
            yield from records(item, node["properties"][field], root, (*path, field))


def part(record: Any, path: tuple[Any, ...]) -> Any:
    """Return the part of a record at a path."""
    for step in path:
        record = record[step]
    return record


@pytest.mark.parametrize("name", SCHEMA_NAMES)
def test_schemas_are_valid_and_give_every_field_a_meaning(name):
    schema = wire_schema(name)
    jsonschema.Draft202012Validator.check_schema(schema)
    for key, definition in schema["$defs"].items():
        for field, properties in definition.get("properties", {}).items():
            assert properties.get("description"), f"{key}.{field}"


def test_schemas_accept_every_exchange_of_the_wire_page():
    with Server(["four_finger"], listen=ANY_LOCAL_PORT) as server, plain_session(server.addresses[0]) as session:
        for exchange in page_exchanges(session, "application/json"):
            if exchange.key.startswith("schema/"):
                jsonschema.Draft202012Validator.check_schema(exchange.reply)
                continue
            if exchange.kind == "token":
                continue
            if exchange.kind in ("state", "signed"):
                names = ["streams/state", "streams/command"]
            elif exchange.kind == "cancel":
                names = [None, "hands/plan/reply"]
            else:
                request = schema_of(exchange.key)
                names = [f"{request}/request", f"{request}/reply" if exchange.kind == "query" else "plans/progress"]
            for name, record in zip(names, (exchange.request, exchange.reply), strict=True):
                if name is not None:
                    validator(name).validate(record)


@CASE
def test_schemas_accept_the_records_that_the_server_reads(case):
    name, record, read = case
    read(copy.deepcopy(record))
    validator(name).validate(json.loads(json.dumps(record)))


@CASE
def test_schemas_have_the_fields_that_the_server_reads(case):
    """An error about an unknown field names the known ones: for each part of the record, those of the schema."""
    name, record, read = case
    schema = wire_schema(name)
    for path, key in records(record, {each: schema[each] for each in ("$ref", "anyOf") if each in schema}, schema):
        changed = copy.deepcopy(record)
        part(changed, path)["not_a_field"] = 1.0
        assert not validator(name).is_valid(changed), path
        with pytest.raises(UnknownField) as caught:
            read(changed)
        fields = set(schema["$defs"][key]["properties"])
        read_before = READ_BEFORE | ({"shape"} if key == "QualityRequest" else set())
        assert set(caught.value.known) - read_before == fields - read_before, (path, key)


@CASE
def test_schemas_require_the_fields_that_the_server_requires(case):
    """Without a field, the server refuses a record if and only if the schema does; only a missing inertia depends on others."""
    name, record, read = case
    schema = wire_schema(name)
    for path, key in records(record, {each: schema[each] for each in ("$ref", "anyOf") if each in schema}, schema):
        for field in schema["$defs"][key].get("required", ()):
            changed = copy.deepcopy(record)
            del part(changed, path)[field]
            with pytest.raises(InvalidInput):
                read(changed)
            assert not validator(name).is_valid(changed), (path, field)


def test_the_records_of_this_test_have_all_parts_of_requests():
    """Apart from closing a stream, and states of joint-space laws, which the page has."""
    seen: set[str] = set()
    for name, record, _ in CASES:
        schema = wire_schema(name)
        seen |= {key for _, key in records(record, {k: schema[k] for k in ("$ref", "anyOf") if k in schema}, schema)}
    known = {key for name in SCHEMA_NAMES if name.endswith(("request", "state")) for key in wire_schema(name)["$defs"]}
    assert known - seen <= {
        "CloseRequest", "StatusRequest", "SetupQuery", "HandRequest", "GraspRank", "GraspClass", "AnalysisRequest",
        "QualityRequest",
        "JointState", "JointMotionRecord", "ForceState", "MeasuredTorqueRecord", "DesiredTorqueRecord",
    }  # fmt: skip


def test_server_answers_queries_for_schemas_with_those_of_the_code():
    with Server([GRASP.hand], listen=ANY_LOCAL_PORT) as server, plain_session(server.addresses[0]) as session:
        [(ok, _, payload)] = get(session, "schema/solve/request")
        assert ok
        answered = json.loads(payload)
        del answered["server_seconds"]
        assert answered == json.loads(json.dumps(wire_schema("solve/request")))
        titles = [json.loads(payload)["title"] for _, _, payload in get(session, "schema/**")]
        assert sorted(titles) == [f"graspforce/1: {name}" for name in SCHEMA_NAMES]
        assert len(get(session, "schema/hands/*/request")) == 7
        for unknown in ("schema", "schema/solve", "schema/no/**"):
            [(ok, _, payload)] = get(session, unknown)
            assert not ok, unknown
            assert json.loads(payload)["error"] == "unknown"
            assert "hands/control/request" in json.loads(payload)["message"]


def test_unknown_schemas_are_answered_with_the_nearest_name():
    ok, error = ask("schema/solve/requests", {})
    assert not ok
    assert re.search(r"did you mean 'solve/request'\?", error["message"])
