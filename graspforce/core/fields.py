"""Checks on records: which fields they hold, and which words a field may say."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from graspforce.core.errors import InvalidInput


def check_record(value: Any, field: str, *, required: Collection[str] = (), optional: Collection[str] = ()) -> dict[str, Any]:
    """A record that has every required field and no field beyond the optional ones.

    Raises:
        InvalidInput: not a record, a field missing, or a field that nobody knows.
    """
    if not isinstance(value, Mapping):
        raise InvalidInput(field, value, "a record (a JSON object)")
    known = [*required, *optional]
    for name in value:
        if name not in known:
            path = f"{field}.{name}" if field else str(name)
            raise InvalidInput(path, value[name], f"absent: the known fields here are {', '.join(known)}")
    for name in required:
        if name not in value:
            raise InvalidInput(f"{field}.{name}" if field else name, None, "given: this field is required")
    return dict(value)


def check_sequence(value: Any, field: str, *, at_least: int = 0) -> list[Any]:
    """A list with at least so many items."""
    allowed = "a list" if at_least == 0 else f"a list of at least {at_least}"
    if isinstance(value, str | bytes) or not isinstance(value, Sequence) or len(value) < at_least:
        raise InvalidInput(field, value, allowed)
    return list(value)


def check_choice(value: Any, field: str, allowed: Collection[str]) -> str:
    """One of the allowed words."""
    if not isinstance(value, str) or value not in allowed:
        raise InvalidInput(field, value, "one of " + ", ".join(allowed))
    return value


def check_text(value: Any, field: str) -> str:
    """Any text."""
    if not isinstance(value, str):
        raise InvalidInput(field, value, "text")
    return value


def check_integer(value: Any, field: str, *, minimum: int, maximum: int) -> int:
    """A whole number in a range, both ends allowed."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not minimum <= value <= maximum:
        raise InvalidInput(field, value, f"a whole number from {minimum} to {maximum}")
    return int(value)


def check_boolean(value: Any, field: str) -> bool:
    """Return ``value`` if it is true or false.

    Raises:
        InvalidInput: anything else.
    """
    if not isinstance(value, bool):
        raise InvalidInput(field, value, "true or false")
    return value
