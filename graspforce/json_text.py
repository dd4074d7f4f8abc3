"""JSON text → plain records, with our own errors; and a force problem from a file."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import msgspec

from graspforce.errors import InvalidInput
from graspforce.problem import ForceProblem

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


def load(path: str | os.PathLike[str]) -> ForceProblem:
    """The force problem in a problem file.

    Args:
        path: of a JSON file with the schema graspforce/problem/1.

    Raises:
        InvalidInput: no such file, not JSON, or not a force problem.
    """
    try:
        text = Path(path).read_bytes()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InvalidInput("file", os.fspath(path), f"a readable file ({reason})") from None
    return ForceProblem.from_dict(decode(text))
