"""Keys, codecs, envelopes and error records of the wire.

All keys begin with `PREFIX`, which has the version of the protocol. The Zenoh encoding of a query selects the codec, JSON if it
has none, and its answer has the same codec. Any request may carry an `Envelope`. An answer is a record, or an error record::

    {"error": code, "message": text, "field": path, "sequence": number}

`field` is null if the error concerns no single field. `sequence` is absent if the request had none. Refusals because of load
have `retry_after`, the time in s after which the request may be repeated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from graspforce.core import arrays, fields, json_text
from graspforce.core.errors import ErrorReply, InvalidInput, RequestRefused, UnknownName, format_value
from graspforce.core.json_text import JsonRecord
from graspforce.core.printable import escape_controls, has_controls

NAMESPACE = "graspforce"  # first part of all keys, of all versions
VERSION = "1"
PREFIX = f"{NAMESPACE}/{VERSION}"
JSON = "application/json"
MSGPACK = "application/msgpack"
REFUSAL_CODES = ("too_large", "overloaded", "deadline", "closing", "forbidden")  # the server did no work
ERROR_CODES = ("invalid", "implausible", "unknown", "internal")
CLOSING_MESSAGE = "the server is closing: send the request to another one"
FLOAT_BYTES = 8
"""Bytes of a number of a binary array: float64, little-endian."""

LARGEST_SEQUENCE = 2**63 - 1
SAMPLE_RATE = 60  # 1/s, at most: sampled states and commands of a stream
SAMPLED = f"sampled/{SAMPLE_RATE}_hz"
"""Key of the samples below that of their stream. It has more parts than an id, so that it is no other stream's key."""
ANSWER_ENVELOPE = ("sequence", "server_seconds")  # fields that any answer may have beside its record

_FORBIDDEN_IN_KEYS = "/*$?#"
_MAX_ID_CHARACTERS = 64
_NO_ENCODING = ("", "zenoh/bytes")  # Zenoh's encoding of a query without one
_MAX_MESSAGE_CHARACTERS = 4000  # a field name comes from the client and may have megabytes
_MIN_RETRY = 0.01  # s
_PREVIEW_BYTES = 40  # of an invalid payload in the error message


@dataclass(frozen=True, slots=True)
class Envelope:
    """Fields that any request may have beside its record.

    Args:
        sequence: number of the client, from 0 to 2⁶³ − 1; the answer repeats it.
        budget: time in which the answer is useful, s, from when the server receives the request.
        backend: name of the solver; None for the server's choice.
    """

    sequence: int | None = None
    budget: float | None = None
    backend: str | None = None

    @classmethod
    def split(cls, request: object) -> tuple[Envelope, object]:
        """Separate the envelope of a request from its record.

        Args:
            request: decoded request; anything but a record is returned as it is.

        Returns:
            The envelope, and the request without the envelope's fields.

        Raises:
            InvalidInput: a field of the envelope has the wrong type or range; names it.
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

    def wrap(self, record: Mapping[str, object]) -> JsonRecord:
        """Return the record with the fields of this envelope that are not None.

        Args:
            record: the request without its envelope.
        """
        own = {"sequence": self.sequence, "budget": self.budget, "backend": self.backend}
        return {**record, **{name: value for name, value in own.items() if value is not None}}


def select_codec(encoding: str | None) -> str:
    """Return the codec of a Zenoh encoding: `JSON` or `MSGPACK`, and `JSON` for none.

    Args:
        encoding: the encoding. Its schema, after ``;``, is ignored, except that of ``zenoh/bytes``: zenoh-pico writes an
            encoding that Zenoh has no number for as the schema of ``zenoh/bytes``.

    Raises:
        InvalidInput: another encoding.
    """
    if encoding == MSGPACK:  # fast path for streams
        return encoding
    name, _, schema = (part.strip() for part in (encoding or "").partition(";"))
    if name in _NO_ENCODING:
        return MSGPACK if schema == MSGPACK else JSON
    if name not in (JSON, MSGPACK):
        raise InvalidInput("encoding", encoding, f"{JSON} or {MSGPACK}, or absent for {JSON}")
    return name


def decode(payload: bytes, codec: str) -> object:
    """Return the plain values of a payload. The type that is read from them checks its fields.

    Args:
        payload: bytes of a message.
        codec: `JSON` or `MSGPACK`.

    Raises:
        InvalidInput: the payload is not JSON, or not MessagePack.
    """
    if codec == JSON:
        return json_text.decode(payload)
    try:
        return msgspec.msgpack.decode(payload)
    except (msgspec.DecodeError, ValueError, TypeError, RecursionError, OverflowError) as error:
        reason = str(error) or type(error).__name__
    raise InvalidInput("input", payload[:_PREVIEW_BYTES], f"MessagePack ({reason})")


def encode(record: object, codec: str) -> bytes:
    """Return the payload of a record. NumPy arrays become lists, NumPy scalars numbers.

    Args:
        record: plain values, arrays and msgspec structs.
        codec: `JSON` or `MSGPACK`.

    Raises:
        InvalidInput: the record has a value that the codec cannot encode.
    """
    write = msgspec.json.encode if codec == JSON else msgspec.msgpack.encode
    try:
        return write(record, enc_hook=_to_plain)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InvalidInput("input", type(record).__name__, f"a record of plain values ({error})") from None


def find_sequence(request: object) -> int | None:
    """Return the sequence number of a decoded request; None if it has none or an invalid one.

    Args:
        request: anything that `decode` returns.
    """
    sequence = request.get("sequence") if isinstance(request, Mapping) else None
    if not isinstance(sequence, int) or isinstance(sequence, bool):
        return None
    return sequence if 0 <= sequence <= LARGEST_SEQUENCE else None


class _Numbered(msgspec.Struct):
    """The sequence number of a request, of any type."""

    sequence: Any = None


_decode_numbered = msgspec.msgpack.Decoder(_Numbered).decode


def read_sequence(payload: bytes, codec: str) -> int | None:
    """Return the sequence number of a request without its other fields; None if it has none, or cannot be read.

    In MessagePack this takes a fraction of the time of `decode`.

    Args:
        payload: bytes of a message.
        codec: `JSON` or `MSGPACK`.
    """
    try:
        return find_sequence({"sequence": _decode_numbered(payload).sequence} if codec == MSGPACK else decode(payload, codec))
    except (InvalidInput, msgspec.MsgspecError, ValueError, TypeError, RecursionError, OverflowError):
        return None


def error_record(
    code: str, message: str, field: str | None = None, sequence: int | None = None, retry_after: float | None = None
) -> JsonRecord:
    """Return an error record. It can always be encoded and printed: long text is cut, control characters are escaped.

    Args:
        code: one of `ERROR_CODES` and `REFUSAL_CODES`.
        message: text for the user.
        field: path of the invalid field.
        sequence: sequence number of the request.
        retry_after: time after which the request may be repeated, s; only refusals have it.
    """
    record: JsonRecord = {
        "error": code,
        "message": _limit_text(escape_controls(message)),
        "field": None if field is None else _limit_text(escape_controls(field)),
    }
    if sequence is not None:
        record["sequence"] = sequence
    if retry_after is not None:
        record["retry_after"] = round(max(retry_after, _MIN_RETRY), 3)
    return record


def read_error(record: object) -> RequestRefused | ErrorReply:
    """Return the exception of an error record.

    Args:
        record: the decoded error record; anything else gives an `ErrorReply` with code ``internal``.
    """
    code = record.get("error") if isinstance(record, Mapping) else None
    if not isinstance(record, Mapping) or code not in REFUSAL_CODES + ERROR_CODES:
        return ErrorReply("internal", f"the server's error record cannot be read: {format_value(record)}", None)
    message, field = escape_controls(str(record.get("message"))), record.get("field")
    if code in REFUSAL_CODES:
        return RequestRefused(code, message, _read_retry(record.get("retry_after")))
    return ErrorReply(code, message, None if field is None else escape_controls(str(field)))


def _read_retry(value: object) -> float | None:
    """Return the time of a refusal's `retry_after`, s; None if it has none."""
    is_time = isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value < math.inf
    return float(value) if is_time else None  # type: ignore[arg-type]


def hand_key(name: str) -> str:
    """Return the key of a hand's description, after the prefix.

    Args:
        name: name of the hand.

    Raises:
        UnknownName: the name is empty or has a reserved character.
    """
    if not isinstance(name, str) or not name or any(c in name for c in _FORBIDDEN_IN_KEYS) or has_controls(name):
        raise UnknownName("hand", name, (), "a hand's name: not empty, and without / * $ ? #")
    return f"hands/{name}"


def check_id(value: object, field: str = "id") -> str:
    """Return the id of a plan or a stream, which is part of keys and of log lines.

    Args:
        value: the id.
        field: its path for error messages.

    Raises:
        InvalidInput: not 1 to 64 characters, a reserved or control character, or @ at the begin.
    """
    id = fields.check_text(value, field)
    is_verbatim = id.startswith("@")  # access rules and subscriptions with wildcards do not match such keys
    if not 0 < len(id) <= _MAX_ID_CHARACTERS or any(c in id for c in _FORBIDDEN_IN_KEYS) or has_controls(id) or is_verbatim:
        allowed = f"1 to {_MAX_ID_CHARACTERS} characters, without / * $ ? # and control characters, and no @ at the begin"
        raise InvalidInput(field, id, allowed)
    return id


def check_named_id(value: object, field: str = "id") -> str:
    """Return the id of a plan or a stream that may begin with the name of its client: ``<id>`` or ``<client>/<id>``.

    With the name, access lists can tie the keys of a plan or a stream to a client.

    Args:
        value: the id.
        field: its path for error messages.

    Raises:
        InvalidInput: a part is not allowed by `check_id`, or there are more than two.
    """
    id = fields.check_text(value, field)
    client, slash, own = id.rpartition("/")
    if slash:
        check_id(client, field)
    check_id(own, field)
    return id


def _to_plain(value: object) -> object:
    """Return the list or number of a NumPy array or scalar, for the encoders."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be encoded")


def _limit_text(text: str) -> str:
    """Return a text that UTF-8 can encode, of limited length."""
    encodable = text[: _MAX_MESSAGE_CHARACTERS + 1].encode("utf-8", "backslashreplace").decode("utf-8")
    if len(encodable) <= _MAX_MESSAGE_CHARACTERS:
        return encodable
    return encodable[: _MAX_MESSAGE_CHARACTERS - 1] + "…"
