"""The JSON Schema in the documentation is that of the code, and the shipped descriptions satisfy it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from graspforce.hand.descriptions.description import MODELS_FOLDER, shipped_hands
from graspforce.hand.descriptions.description_schema import description_schema

ROOT = Path(__file__).parents[3]


def test_schema_in_the_documentation_is_that_of_the_code() -> None:
    """To renew it: graspforce hands schema > docs/schemas/hand.json"""
    assert json.loads((ROOT / "docs" / "schemas" / "hand.json").read_text()) == json.loads(json.dumps(description_schema()))


def test_every_field_has_a_meaning() -> None:
    for name, definition in description_schema()["$defs"].items():
        for field, properties in definition["properties"].items():
            assert properties["description"], f"{name}.{field}"


@pytest.mark.parametrize("name", shipped_hands())
def test_shipped_descriptions_have_only_fields_of_the_schema(name: str) -> None:
    definitions = description_schema()["$defs"]
    record = json.loads((MODELS_FOLDER / f"{name}.json").read_text())

    def check(values: Any, definition: dict[str, Any], where: str) -> None:
        assert set(values) <= set(definition["properties"]), where
        assert set(definition["required"]) <= set(values), where

    check(record, definitions["HandDescription"], name)
    for field, kind in (("fingers", "Finger"), ("motors", "Motor"), ("drives", "Drive"), ("couplings", "")):
        for i, each in enumerate(record.get(field, ())):
            check(each, definitions[f"{kind}Description" if kind else "Coupling"], f"{name}.{field}[{i}]")


def test_table_of_the_documentation_names_every_field() -> None:
    text = (ROOT / "docs" / "hands.md").read_text()
    for field in description_schema()["$defs"]["HandDescription"]["properties"]:
        assert f"`{field}" in text, field
