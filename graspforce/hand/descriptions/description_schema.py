"""The JSON Schema of description files, generated from their records."""

from __future__ import annotations

from typing import Any

import msgspec

from graspforce.core.field_meanings import field_meanings, record_summary
from graspforce.core.json_text import JsonRecord
from graspforce.hand.descriptions import description, drive_description
from graspforce.hand.descriptions.description import HandDescription


def description_schema() -> JsonRecord:
    """Return the JSON Schema (2020-12) of description files, with the meaning and the unit of every field."""
    schema: dict[str, Any] = msgspec.json.schema(HandDescription)
    for name, definition in schema["$defs"].items():
        record = getattr(description, name, None) or getattr(drive_description, name)
        definition["description"] = record_summary(record, "Attributes")
        meanings = field_meanings(record, "Attributes")
        for field, properties in definition["properties"].items():
            properties["description"] = meanings[field]
    title = "Hand description of graspforce"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title, **schema}
