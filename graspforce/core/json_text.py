"""JSON text to plain records, with graspforce's own errors."""

from __future__ import annotations

import json
from typing import Any

import msgspec

from graspforce.core.errors import InvalidInput

_PREVIEW = 40  # bytes of a text that is not JSON which the error shows


def decode(text: bytes) -> Any:
    """What a JSON text says, as plain dicts, lists, numbers and strings.

    NaN and Infinity, which JSON does not know but many programs write, are read, so that the check of the field that holds
    one can name it.

    Raises:
        InvalidInput: not JSON.
    """
    try:
        return msgspec.json.decode(text)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        reason = str(error) or type(error).__name__
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        start = text[:_PREVIEW].decode("utf-8", "replace")
        raise InvalidInput("input", start, f"JSON ({reason})") from None
