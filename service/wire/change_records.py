"""Changes of the contacts of a stream: in the states of the client, and in the commands of the server."""

from __future__ import annotations

from typing import NamedTuple

import msgspec

from graspforce.control import ContactChange
from graspforce.core import fields
from graspforce.core.json_text import JsonRecord
from graspforce.hand.hand import Hand
from graspforce.service.wire import protocol


class NumberedChange(NamedTuple):
    """A change of contacts with its number, which grows from change to change.

    Attributes:
        number: number of the change, from 1.
        change: fingers that let go, and contacts of fingers that join.
    """

    number: int
    change: ContactChange

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `number` and the fields of `ContactChange.to_dict`."""
        return {"number": self.number, **self.change.to_dict()}

    @classmethod
    def from_dict(cls, record: object, hand: Hand, field: str = "contacts") -> NumberedChange:
        """Read a change from a plain record.

        Args:
            record: as `to_dict` returns it; all fields but `number` may be absent or null.
            hand: the hand.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=["number"], optional=["release", "add", "force_rate"])
        number = read_change_number(values.pop("number"), f"{field}.number", minimum=1)
        return cls(number, ContactChange.from_dict(values, hand, field))


class ContactChangeRecord(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    """Contacts of a command in a stream whose contacts have changed.

    Args:
        number: number of the last change that has begun; 0 before the first.
        fingers: names of the fingers, in the order of the command's contacts.
        changing: whether contacts let go or join.
        refused: number of the last change that was refused; None if none was.
    """

    number: int
    fingers: tuple[str, ...]
    changing: bool
    refused: int | None = None


def read_change_number(value: object, field: str, minimum: int = 0) -> int:
    """Return the number of a change.

    Args:
        value: the number.
        field: its path, for errors.
        minimum: the smallest allowed number.

    Raises:
        InvalidInput: not an integer, or out of range.
    """
    return fields.check_integer(value, field, minimum=minimum, maximum=protocol.LARGEST_SEQUENCE)
