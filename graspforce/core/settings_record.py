"""Base of settings that are stored as records: plain values by name."""

from __future__ import annotations

import dataclasses
from typing import ClassVar, TypeVar

from graspforce.core import fields
from graspforce.core.json_text import JsonRecord

T = TypeVar("T", bound="SettingsRecord")


class SettingsRecord:
    """Base of dataclasses of settings, each with a default and a plain value.

    Attributes:
        RECORD: path of the record in error messages, unless another one is given.
    """

    __slots__ = ()
    RECORD: ClassVar[str]

    def to_dict(self) -> JsonRecord:
        """Return the record: every setting under its name."""
        values = dataclasses.asdict(self)  # type: ignore[call-overload]  # every subclass is a dataclass
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}

    @classmethod
    def from_dict(cls: type[T], record: object, field: str | None = None) -> T:
        """Return the settings of a record. Settings that are absent or null take their defaults.

        Args:
            record: mapping with the settings by name.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a setting is unknown or out of range; names it with its path.
        """
        return fields.read_dataclass(cls, record, cls.RECORD if field is None else field)
