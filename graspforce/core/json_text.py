"""JSON text: decoding with graspforce's own errors, and the type of a plain record."""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

from graspforce.core.errors import InvalidInput

# A JSON object: text keys; the values are None, booleans, numbers, text, and lists and records of these.
JsonRecord: TypeAlias = dict[str, Any]

_PREVIEW = 40  # bytes of an invalid text in the error message
_MALFORMED = "JSON is malformed: "  # beginning of msgspec's messages
_OFFSET = re.compile(r"\(byte (\d+)\)")  # of an error in msgspec's messages


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
        raise InvalidInput("input", start, f"JSON ({locate_error(text, reason).removeprefix(_MALFORMED)})") from None


def read(path: str | os.PathLike[str]) -> object:
    """Return the plain values of a JSON file.

    Args:
        path: the file, in UTF-8.

    Raises:
        InvalidInput: not JSON; names the file, and line and column of the error.
        OSError: the file cannot be read.
    """
    text = Path(path).read_bytes()
    with errors_of_file(path):
        return decode(text)


@contextlib.contextmanager
def errors_of_file(path: str | os.PathLike[str]) -> Iterator[None]:
    """Name a file in the errors of values that were read from it.

    Args:
        path: the file.
    """
    try:
        yield
    except InvalidInput as error:
        error.source = error.source or os.fspath(path)
        raise


def locate_error(text: bytes, reason: str) -> str:
    """Return an error message of msgspec with line and column in place of the offset in bytes.

    Args:
        text: the invalid JSON.
        reason: the message, such as ``JSON is malformed: invalid character (byte 15)``.
    """
    found = _OFFSET.search(reason)
    if found is None:
        return reason
    before = text[: int(found.group(1))]
    line, column = before.count(b"\n") + 1, len(before.rpartition(b"\n")[2].decode("utf-8", "replace")) + 1
    return f"{reason[: found.start()].rstrip()}, line {line}, column {column}{reason[found.end() :]}"
