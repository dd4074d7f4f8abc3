"""The option ``--drive`` of the command line: one drive for all joints of a hand."""

from __future__ import annotations

import dataclasses
from typing import Any

from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.hand.descriptions.drive_description import DRIVE_MODES
from graspforce.hand.drives.drive import Drive

_NUMBERS = tuple(each.name for each in dataclasses.fields(Drive) if each.name not in ("mode", "thermal", "source"))


def parse_drive(text: str) -> Drive:
    """Return the drive of a text such as "position,stiffness=20,damping=0.1".

    Args:
        text: the mode, and numbers of `Drive` at the joint.

    Raises:
        InvalidInput: another form, an unknown mode, or a number that is missing or out of range.
        UnknownName: no such number.
    """
    mode, *pairs = text.split(",")
    values: dict[str, Any] = {"mode": fields.check_choice(mode, "--drive", DRIVE_MODES)}
    for pair in pairs:
        name, separator, number = pair.partition("=")
        if not separator:
            raise InvalidInput("--drive", pair, "NAME=VALUE after the mode, such as stiffness=20")
        if name not in _NUMBERS:
            raise UnknownName("--drive", name, _NUMBERS)
        try:
            values[name] = arrays.check_number(float(number), f"--drive {name}", minimum=0.0)
        except ValueError:
            raise InvalidInput(f"--drive {name}", number, "a number") from None
    try:
        return Drive(**values)
    except InvalidInput as error:
        raise error.with_prefix("--drive") from None
