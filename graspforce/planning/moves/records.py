"""Fields that the records of all moves share, and the names of fields in records."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from graspforce.core import fields
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord

# Python's name of a field: its name in a record, where the two differ
_RECORD_NAMES = {"p_HO": "poses", "q_start": "posture", "path_type": "way", "clearance": "apart", "workspace": "room"}
_SETTING_FIELDS = ("intervals", "tolerance")


def check_move_record(record: object, required: tuple[str, ...], optional: tuple[str, ...]) -> JsonRecord:
    """Return the fields of a move's record that are not null.

    Args:
        record: the record.
        required: names of the fields that must be given, beside ``method``.
        optional: names of the fields that may be given, beside the settings.

    Raises:
        InvalidInput: a field is missing or unknown; names it.
    """
    known = {"required": ("method", *required), "optional": (*optional, *_SETTING_FIELDS)}
    values = fields.check_record(record, "", **known)
    return fields.check_record({name: value for name, value in values.items() if value is not None}, "", **known)


@contextmanager
def errors_by_record_name() -> Iterator[None]:
    """Name the fields of errors as in a record."""
    try:
        yield
    except InvalidInput as error:
        name = re.split(r"[.[]", error.field, maxsplit=1)[0]
        raise error.with_field(_RECORD_NAMES.get(name, name) + error.field[len(name) :]) from None


def part(values: JsonRecord, names: tuple[str, ...]) -> JsonRecord:
    """Return the part of a record with some names.

    Args:
        values: the record.
        names: names of fields, present or not.
    """
    return {name: values[name] for name in names if name in values}


def settings_of_record(values: JsonRecord) -> JsonRecord:
    """Return the settings of a record, as arguments of a move.

    Args:
        values: the record.
    """
    return part(values, _SETTING_FIELDS)
