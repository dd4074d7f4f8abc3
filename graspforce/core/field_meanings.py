"""Meanings of fields, as the docstring of their record states them."""

from __future__ import annotations

import inspect
import re


def field_meanings(record: type, section: str) -> dict[str, str]:
    """Return the text of each field in the docstring of a record, by name.

    Args:
        record: the class.
        section: heading of the list of fields, such as ``"Args"``.
    """
    lines = (inspect.getdoc(record) or "").partition(f"\n\n{section}:\n")[2].splitlines()
    meanings: dict[str, str] = {}
    names: list[str] = []
    for line in lines:
        if line and not line.startswith(" "):
            break  # another heading
        entry = re.match(r" {4}(\w+(?:, \w+)*): (.*)", line)
        if entry:
            names = entry[1].split(", ")
            meanings |= dict.fromkeys(names, entry[2])
        else:
            meanings |= {name: f"{meanings[name]} {line.strip()}".strip() for name in names}
    return meanings


def record_summary(record: type, section: str) -> str:
    """Return the text of a record's docstring before its list of fields, in one line.

    Args:
        record: the class.
        section: heading of the list of fields.
    """
    text = (inspect.getdoc(record) or "").partition(f"\n\n{section}:")[0]
    return " ".join(text.split())
