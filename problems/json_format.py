"""Format case records as JSON: an indented file, or one line of a bundle."""

from __future__ import annotations

import json
from typing import Any


def format_case(value: Any, indent: int = 0) -> str:
    """Return indented JSON: one line for each field and each row, and lists of scalars on one line."""
    pad = " " * (indent + 2)
    nested = indent == 0 or (isinstance(value, dict) and any(isinstance(item, dict | list) for item in value.values()))
    if isinstance(value, dict) and nested and indent < 4:
        lines = [f"{pad}{json.dumps(key)}: {format_case(item, indent + 2)}" for key, item in value.items()]
        return "{\n" + ",\n".join(lines) + "\n" + pad[2:] + "}"
    if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        return "[\n" + ",\n".join(pad + format_case(item, indent + 4) for item in value) + "\n" + pad[2:] + "]"
    return json.dumps(value, ensure_ascii=False)


def format_case_line(value: Any) -> str:
    """Return JSON on one line, without spaces."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))
