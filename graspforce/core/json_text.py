"""JSON text: decoding with graspforce's own errors, and the type of a plain record."""

from __future__ import annotations

import json
from typing import Any, TypeAlias

from graspforce.core.errors import InvalidInput

# A JSON object: text keys; the values are None, booleans, numbers, text, and lists and records of these.
JsonRecord: TypeAlias = dict[str, Any]

_PREVIEW = 40  # bytes of an invalid text in the error message


def decode(text: bytes) -> object:
    """Return the plain dicts, lists, numbers and strings of a JSON text.

    NaN and Infinity are not JSON, but many programs write them. They are read, so that the check of their field can name them.

    Args:
        text: JSON in UTF-8.

    Raises:
        InvalidInput: not JSON.
    """
    import msgspec  # imported here to keep `import graspforce` fast

    try:
        return msgspec.json.decode(text)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        reason = str(error) or type(error).__name__
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        start = text[:_PREVIEW].decode("utf-8", "replace")
        raise InvalidInput("input", start, f"JSON ({reason})") from None
