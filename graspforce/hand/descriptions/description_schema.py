"""The JSON Schema of description files, generated from their records."""

from __future__ import annotations

import inspect
import re
from typing import Any

import msgspec

from graspforce.core.json_text import JsonRecord
from graspforce.hand.descriptions import description, drive_description
from graspforce.hand.descriptions.description import HandDescription


def description_schema() -> JsonRecord:
    """Return the JSON Schema (2020-12) of description files, with the meaning and the unit of every field."""
    schema: dict[str, Any] = msgspec.json.schema(HandDescription)
    for name, definition in schema["$defs"].items():
        record = getattr(description, name, None) or getattr(drive_description, name)
        text = inspect.getdoc(record) or ""
        definition["description"] = text.partition("\n\nAttributes:")[0].replace("\n", " ").strip()
        meanings = _field_meanings(text)
        for field, properties in definition["properties"].items():
            properties["description"] = meanings[field]
    title = "Hand description of graspforce"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title, **schema}


def _field_meanings(text: str) -> dict[str, str]:
    """Return the text of each attribute in a docstring."""
    lines = text.partition("\n\nAttributes:\n")[2].splitlines()
    meanings: dict[str, str] = {}
    name = ""
    for line in lines:
        entry = re.match(r" {4}(\w+): (.*)", line)
        if entry:
            name = entry[1]
            meanings[name] = entry[2]
        elif name:
            meanings[name] = f"{meanings[name]} {line.strip()}".strip()
    return meanings
