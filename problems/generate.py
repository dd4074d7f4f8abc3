"""Write the case files from their derivations: ``python -m graspforce.problems.generate``, in a checkout."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from graspforce.problems.derivations import fixture, nose_cone, opposed, ring
from graspforce.problems.derivations.records import Record


def records() -> Iterator[Record]:
    """The records of all case files."""
    for collection in (fixture, nose_cone, opposed, ring):
        yield from collection.cases()


def written(value: Any, indent: int = 0) -> str:
    """JSON that reads well: a line for each field and each row, lists of plain values on one line."""
    pad = " " * (indent + 2)
    nested = indent == 0 or (isinstance(value, dict) and any(isinstance(item, dict | list) for item in value.values()))
    if isinstance(value, dict) and nested and indent < 4:
        lines = [f"{pad}{json.dumps(key)}: {written(item, indent + 2)}" for key, item in value.items()]
        return "{\n" + ",\n".join(lines) + "\n" + pad[2:] + "}"
    if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        return "[\n" + ",\n".join(pad + written(item, indent + 4) for item in value) + "\n" + pad[2:] + "]"
    return json.dumps(value, ensure_ascii=False)


def main() -> None:
    """Write every case file beside this one."""
    here = Path(__file__).parent
    for record in records():
        path = here / f"{record['name']}.json"
        path.parent.mkdir(exist_ok=True)
        path.write_text(written(record) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
