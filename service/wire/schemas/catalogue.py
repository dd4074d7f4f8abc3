"""The JSON Schemas of all records of the wire by name, generated from their types."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from functools import cache
from typing import Any

import msgspec

from graspforce.core.errors import UnknownName
from graspforce.core.field_meanings import field_meanings, record_summary
from graspforce.core.json_text import JsonRecord
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.wire.joint_records import JointCommandRecord
from graspforce.service.wire.phase_records import PhaseCommandRecord
from graspforce.service.wire.schemas import move_types, reply_types, request_types, solution_types, stream_types
from graspforce.service.wire.schemas.status_type import StatusReply

SCHEMA = "schema"
"""First part of the keys of schemas, after the prefix."""

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_SETUPS = (stream_types.ControlSetup, stream_types.PhaseSetup, stream_types.JointSetup, stream_types.CloseRequest)
_STATES = (stream_types.ControlState, stream_types.PhaseState, stream_types.JointState, stream_types.ForceState)
_MOVES = (move_types.PathMoveRequest, move_types.FreeMoveRequest, move_types.FingersMoveRequest)
_REQUESTS: dict[str, tuple[tuple[type, ...], tuple[type, ...]]] = {
    "status": ((request_types.StatusRequest,), (StatusReply,)),
    "solve": ((request_types.SolveRequest,), (solution_types.SolutionReply,)),
    "quality": ((request_types.QualityRequest,), (solution_types.QualityReply,)),
    "explain": ((request_types.AnalysisRequest,), (solution_types.ExplainReply,)),
    "hands": ((request_types.HandRequest,), (reply_types.HandReply,)),
    "hands/forward": ((request_types.ForwardRequest,), (reply_types.ForwardReply,)),
    "hands/inverse": ((request_types.InverseRequest,), (reply_types.InverseReply,)),
    "hands/grasp": ((request_types.GraspSearchRequest,), (reply_types.GraspReply,)),
    "hands/regrasp": ((move_types.RegraspRequest,), (reply_types.RegraspReply,)),
    "hands/distribute": ((request_types.DistributeRequest,), (solution_types.SolutionReply,)),
    "hands/control": ((request_types.ControlRequest,), (CommandRecord,)),
    "hands/plan": (_MOVES, (reply_types.PlanReply,)),
    "setups": ((request_types.SetupQuery,), (reply_types.SetupReply,)),
    "streams": (_SETUPS, (reply_types.OpenedReply, reply_types.ClosedReply)),
}
_MESSAGES: dict[str, tuple[type, ...]] = {
    "streams/state": _STATES,
    "streams/command": (CommandRecord, PhaseCommandRecord, JointCommandRecord, solution_types.ErrorReply),
    "plans/progress": (reply_types.ProgressRecord,),
    "error": (solution_types.ErrorReply,),
}
_TYPES: dict[str, tuple[type, ...]] = {
    **{f"{name}/request": requests for name, (requests, _) in _REQUESTS.items()},
    **{f"{name}/reply": replies for name, (_, replies) in _REQUESTS.items()},
    **_MESSAGES,
}

SCHEMA_NAMES = tuple(sorted(_TYPES))
"""Names of the schemas, which follow `SCHEMA` in their keys."""


@cache
def wire_schema(name: str) -> JsonRecord:
    """Return a JSON Schema (2020-12), with the meaning and the unit of every field. Do not change it.

    Args:
        name: one of `SCHEMA_NAMES`.

    Raises:
        UnknownName: another name; lists the names.
    """
    if name not in _TYPES:
        raise UnknownName("schema", name, SCHEMA_NAMES)
    kinds = _TYPES[name]
    references, definitions = msgspec.json.schema_components(kinds, ref_template="#/$defs/{name}")
    for kind in _struct_types(kinds):
        _describe(definitions[kind.__name__], kind)
    top = references[0] if len(kinds) == 1 else {"anyOf": list(references)}
    plain = {"$schema": _DIALECT, "title": f"graspforce/1: {name}", **top, "$defs": definitions}
    return _without_binary(plain)  # type: ignore[return-value]  # a record stays one


def _struct_types(kinds: tuple[type, ...]) -> Iterator[type]:
    """Yield the types of records that types contain, and themselves."""
    seen: set[type] = set()
    waiting: list[Any] = [msgspec.inspect.type_info(kind) for kind in kinds]
    while waiting:
        info = waiting.pop()
        if isinstance(info, msgspec.inspect.StructType):
            if info.cls in seen:
                continue
            seen.add(info.cls)
            yield info.cls
            waiting += [each.type for each in info.fields]
        for part in ("type", "item_type", "value_type"):
            waiting += [getattr(info, part)] if hasattr(info, part) else []
        waiting += [*getattr(info, "types", ()), *getattr(info, "item_types", ())]


def _describe(definition: dict[str, Any], kind: type) -> None:
    """Set the descriptions of a record and of its fields, from the docstrings of its type and of the types that it extends."""
    definition["description"] = record_summary(kind, "Args")
    meanings: dict[str, str] = {}
    for base in reversed(inspect.getmro(kind)):
        meanings |= field_meanings(base, "Args") if base.__doc__ and issubclass(base, msgspec.Struct) else {}
    for field, properties in definition["properties"].items():
        if field == kind.__struct_config__.tag_field:  # type: ignore[attr-defined]  # a msgspec.Struct
            properties["description"] = "kind of the record"
        elif field in meanings:
            properties["description"] = meanings[field]


def _without_binary(value: object) -> object:
    """Return a schema without the binary form of arrays, which JSON does not have."""
    if isinstance(value, dict):
        return {name: _without_binary(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_without_binary(item) for item in value if not (isinstance(item, dict) and "contentEncoding" in item)]
    return value
