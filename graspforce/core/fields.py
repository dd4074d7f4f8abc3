"""Checks of plain records: their fields, lists, choices, texts and integers. Each returns the value that it checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from typing import Any, TypeVar, cast

import numpy as np

from graspforce.core.errors import InvalidInput, MissingField, UnknownField, nearest_name
from graspforce.core.json_text import JsonRecord

Choice = TypeVar("Choice", bound=str)
T = TypeVar("T")


def check_record(
    value: object, field: str, *, required: Collection[str] = (), optional: Collection[str] | None = ()
) -> JsonRecord:
    """Return a copy of a record that has all required fields and no unknown ones.

    Args:
        value: the value to check.
        field: its path for error messages; "" for the outermost record.
        required: names of the fields that must be given.
        optional: names of the fields that may be given; None for any fields.

    Raises:
        InvalidInput: not a record.
        UnknownField: a field that is neither required nor optional; suggests the nearest one.
        MissingField: a required field is not given.
    """
    if not isinstance(value, Mapping):
        raise InvalidInput(field, value, "a record (a JSON object)")
    known = [*required, *(optional or ())]
    for name in value:
        if optional is not None and name not in known:
            raise UnknownField(f"{field}.{name}" if field else str(name), value[name], known)
    for name in required:
        if name not in value:
            raise MissingField(f"{field}.{name}" if field else name)
    return dict(value)


def check_sequence(value: object, field: str, *, at_least: int = 0) -> list[Any]:
    """Return a sequence as a list.

    Args:
        value: the value to check.
        field: its path for error messages.
        at_least: smallest number of items.

    Raises:
        InvalidInput: not a sequence (text is not one), or too few items.
    """
    allowed = "a list" if at_least == 0 else f"a list of at least {at_least}"
    if isinstance(value, str | bytes) or not isinstance(value, Sequence) or len(value) < at_least:
        raise InvalidInput(field, value, allowed)
    return list(value)


def check_choice(value: object, field: str, allowed: Collection[Choice]) -> Choice:
    """Return a text that is one of the allowed words.

    Args:
        value: the value to check.
        field: its path for error messages.
        allowed: the words.

    Raises:
        InvalidInput: another value; lists the words and suggests the nearest one.
    """
    if not isinstance(value, str) or value not in allowed:
        nearest = nearest_name(value, allowed)
        hint = "" if nearest is None else f"; did you mean {nearest!r}?"
        raise InvalidInput(field, value, f"one of {', '.join(allowed)}{hint}")
    return cast("Choice", value)


def check_text(value: object, field: str) -> str:
    """Return a text.

    Args:
        value: the value to check.
        field: its path for error messages.

    Raises:
        InvalidInput: not text.
    """
    if not isinstance(value, str):
        raise InvalidInput(field, value, "text")
    return value


def check_integer(value: object, field: str, *, minimum: int, maximum: int) -> int:
    """Return an integer in a range.

    Args:
        value: the value to check; neither a boolean nor a float is an integer.
        field: its path for error messages.
        minimum: smallest allowed value.
        maximum: largest allowed value.

    Raises:
        InvalidInput: not an integer, or outside the range.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not minimum <= value <= maximum:
        raise InvalidInput(field, value, f"an integer from {minimum} to {maximum}")
    return int(value)


def check_boolean(value: object, field: str) -> bool:
    """Return a boolean.

    Args:
        value: the value to check.
        field: its path for error messages.

    Raises:
        InvalidInput: neither true nor false.
    """
    if not isinstance(value, bool):
        raise InvalidInput(field, value, "true or false")
    return value


def read_dataclass(cls: type[T], record: object, field: str) -> T:
    """Return an instance of a dataclass whose fields have defaults, from a record of plain values.

    Args:
        cls: the dataclass; it validates its values.
        record: mapping with its fields by name. Fields that are absent or null take their defaults.
        field: path of the record, for error messages.

    Raises:
        InvalidInput: a field is unknown or out of range; names it with its path.
    """
    values = check_record(record, field, optional=[each.name for each in dataclasses.fields(cls)])  # type: ignore[arg-type]
    try:
        return cls(**{name: value for name, value in values.items() if value is not None})
    except InvalidInput as error:
        raise error.with_prefix(field) from None
