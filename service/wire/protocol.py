"""Bytes ↔ records: encodings, the envelope every request may carry, and error records.

The wire is versioned by its keys (`PREFIX`) and by the schema that its records name. A query's Zenoh encoding picks the codec;
a query that names none speaks JSON; every answer comes in the codec of its question.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from graspforce.core import arrays, fields, json_text
from graspforce.core.errors import ErrorReply, InvalidInput, RequestRefused, UnknownName, format_value

PREFIX = "graspforce/1"
JSON = "application/json"
MSGPACK = "application/msgpack"
REFUSAL_CODES = ("too_large", "overloaded", "deadline")  # the work was not done, and may be asked for again
ERROR_CODES = ("invalid", "unknown", "internal")
LARGEST_SEQUENCE = 2**63 - 1

_FORBIDDEN_IN_KEYS = "/*$?#"
_LONGEST_ID = 64  # characters
_NO_ENCODING = ("", "zenoh/bytes")  # what Zenoh says of a query whose sender named no encoding
_LONGEST_MESSAGE = 4000  # characters: a field's name comes from the caller and may be megabytes long
_PREVIEW_BYTES = 40  # bytes of a payload that is not what it says which the error shows


@dataclass(frozen=True, slots=True)
class Envelope:
    """What any request may carry beside its record.

    Args:
        sequence: a number of the caller's, from 0, that the answer repeats.
        budget: how long the caller will wait, s, counted from the moment the request reached the server.
        backend: which solver to use; None for the server's choice.
    """

    sequence: int | None = None
    budget: float | None = None
    backend: str | None = None

    @classmethod
    def split(cls, request: Any) -> tuple[Envelope, Any]:
        """A request without its envelope, and the envelope. What is no record at all comes back as it is.

        Raises:
            InvalidInput: names the envelope's field.
        """
        if not isinstance(request, Mapping):
            return cls(), request
        rest = dict(request)
        sequence, budget, backend = rest.pop("sequence", None), rest.pop("budget", None), rest.pop("backend", None)
        if sequence is not None:
            sequence = fields.check_integer(sequence, "sequence", minimum=0, maximum=LARGEST_SEQUENCE)
        if budget is not None:
            budget = arrays.check_number(budget, "budget", above=0.0)
        if backend is not None:
            backend = fields.check_text(backend, "backend")
        return cls(sequence, budget, backend), rest

    def wrap(self, record: Mapping[str, Any]) -> dict[str, Any]:
        """The record with this envelope's fields, those that say anything."""
        named = {"sequence": self.sequence, "budget": self.budget, "backend": self.backend}
        return {**record, **{name: value for name, value in named.items() if value is not None}}


def select_codec(encoding: str | None) -> str:
    """The codec that a Zenoh encoding names: `JSON` or `MSGPACK`, JSON where it names none. A schema after ``;`` is not read.

    Raises:
        InvalidInput: another encoding.
    """
    if encoding == MSGPACK:  # a stream's, a thousand times a second
        return encoding
    name = (encoding or "").partition(";")[0].strip()
    if name in _NO_ENCODING:
        return JSON
    if name not in (JSON, MSGPACK):
        raise InvalidInput("encoding", encoding, f"{JSON} or {MSGPACK}, or absent for {JSON}")
    return name


def decode(payload: bytes, codec: str) -> Any:
    """What a payload says, as plain values: the checks of the record that it should be come later and name the field.

    Raises:
        InvalidInput: not JSON, or not MessagePack.
    """
    if codec == JSON:
        return json_text.decode(payload)
    try:
        return msgspec.msgpack.decode(payload)
    except (msgspec.DecodeError, ValueError, TypeError, RecursionError, OverflowError) as error:
        reason = str(error) or type(error).__name__
    raise InvalidInput("input", payload[:_PREVIEW_BYTES], f"MessagePack ({reason})")


def encode(record: Any, codec: str) -> bytes:
    """A record as a payload. NumPy's arrays and numbers become plain ones.

    Raises:
        InvalidInput: the record holds what the codec has no word for.
    """
    write = msgspec.json.encode if codec == JSON else msgspec.msgpack.encode
    try:
        return write(record, enc_hook=_to_plain)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InvalidInput("input", type(record).__name__, f"a record of plain values ({error})") from None


def find_sequence(request: Any) -> int | None:
    """The sequence number of a request that may be anything; None where there is none to repeat."""
    sequence = request.get("sequence") if isinstance(request, Mapping) else None
    if not isinstance(sequence, int) or isinstance(sequence, bool):
        return None
    return sequence if 0 <= sequence <= LARGEST_SEQUENCE else None


def error_record(code: str, message: str, field: str | None = None, sequence: int | None = None) -> dict[str, Any]:
    """The record of what went wrong. Its text can always be encoded, whatever the caller wrote."""
    record: dict[str, Any] = {
        "error": code,
        "message": _limit_text(message),
        "field": None if field is None else _limit_text(field),
    }
    if sequence is not None:
        record["sequence"] = sequence
    return record


def read_error(record: Any) -> RequestRefused | ErrorReply:
    """What an error record says, as the exception that a caller can catch; ``internal`` where it cannot be read."""
    code = record.get("error") if isinstance(record, Mapping) else None
    if code not in REFUSAL_CODES + ERROR_CODES:
        return ErrorReply("internal", f"the server's error could not be read: {format_value(record)}", None)
    message, field = str(record.get("message")), record.get("field")
    if code in REFUSAL_CODES:
        return RequestRefused(code, message)
    return ErrorReply(code, message, None if field is None else str(field))


def hand_key(name: str) -> str:
    """The key of a hand's description, below the prefix.

    Raises:
        UnknownName: no hand can have that name: it would be read as another key.
    """
    if not isinstance(name, str) or not name or any(c in name for c in _FORBIDDEN_IN_KEYS):
        raise UnknownName("hand", name, (), "a hand's name: not empty, and without / * $ ? #")
    return f"hands/{name}"


def check_plan_id(value: Any) -> str:
    """What can be a plan's id.

    Raises:
        InvalidInput: it is none.
    """
    id = fields.check_text(value, "id")
    if not 0 < len(id) <= _LONGEST_ID or any(c in id for c in _FORBIDDEN_IN_KEYS):
        raise InvalidInput("id", id, f"1 to {_LONGEST_ID} characters, and without / * $ ? #")
    return id


def _to_plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in a record")


def _limit_text(text: str) -> str:
    """The same text where UTF-8 can write it and it is of readable length; else the nearest that is."""
    written = text[: _LONGEST_MESSAGE + 1].encode("utf-8", "backslashreplace").decode("utf-8")
    return written if len(written) <= _LONGEST_MESSAGE else written[: _LONGEST_MESSAGE - 1] + "…"
