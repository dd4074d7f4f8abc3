"""Problem files with one invalid field each, and the field and allowed values that the error must name.

The same list is used in Python, on the command line and over the wire: the message must be the same.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

VALID_PROBLEM: dict[str, Any] = {
    "schema": "graspforce/problem/1",
    "contacts": [
        {"position": [0.0, -0.03, 0.0], "normal": [0, 1, 0], "friction": 0.5, "max_normal": 20.0},
        {"position": [0.0, 0.03, 0.0], "normal": [0, -1, 0], "friction": 0.5, "model": "soft", "torsional_friction": 0.01},
    ],
    "wrench": [0, 0, 1.0, 0, 0, 0],
    "hand": {
        "jacobian": [[0.01 * (row + column) for column in range(2)] for row in range(7)],
        "torque_lower": [-0.7, None],
        "torque_upper": [0.7, 0.5],
    },
}


@dataclass(frozen=True)
class InvalidCase:
    """`VALID_PROBLEM` with ``value`` at ``path``, and the field and the allowed values that the error names."""

    name: str
    path: tuple[str | int, ...]
    value: Any
    field: str
    allowed: str

    def record(self) -> dict[str, Any]:
        record = copy.deepcopy(VALID_PROBLEM)
        inner: Any = record
        for step in self.path[:-1]:
            inner = inner[step]
        if self.value is REMOVED:
            del inner[self.path[-1]]
        else:
            inner[self.path[-1]] = self.value
        return record


REMOVED: Callable[..., Any] = object
NAN, INF = float("nan"), float("inf")

INVALID_CASES = [
    InvalidCase("unknown field", ("wrnch",), [0] * 6, "wrnch", "absent: the known fields are schema, contacts, wrench"),
    InvalidCase("no wrench", ("wrench",), REMOVED, "wrench", "given"),
    InvalidCase("no schema", ("schema",), REMOVED, "schema", "given"),
    InvalidCase("another schema", ("schema",), "graspforce/problem/2", "schema", "one of graspforce/problem/1"),
    InvalidCase("no contacts", ("contacts",), [], "contacts", "a list of at least 1"),
    InvalidCase("contacts no list", ("contacts",), {"a": 1}, "contacts", "a list of at least 1"),
    InvalidCase("contact no record", ("contacts", 1), 3, "contacts[1]", "a record"),
    InvalidCase("unknown contact field", ("contacts", 0, "mu"), 0.5, "contacts[0].mu", "absent: the known fields are"),
    InvalidCase("no friction", ("contacts", 0, "friction"), REMOVED, "contacts[0].friction", "a finite number, at least 0"),
    InvalidCase("negative friction", ("contacts", 0, "friction"), -0.5, "contacts[0].friction", "at least 0"),
    InvalidCase("friction text", ("contacts", 0, "friction"), "0.5", "contacts[0].friction", "a finite number, at least 0"),
    InvalidCase("friction boolean", ("contacts", 0, "friction"), True, "contacts[0].friction", "a finite number, at least 0"),
    InvalidCase("friction NaN", ("contacts", 0, "friction"), NAN, "contacts[0].friction", "a finite number, at least 0"),
    InvalidCase("friction infinite", ("contacts", 1, "friction"), INF, "contacts[1].friction", "a finite number, at least 0"),
    InvalidCase("zero normal", ("contacts", 0, "normal"), [0, 0, 0], "contacts[0].normal", "a direction: not zero"),
    InvalidCase("short normal", ("contacts", 0, "normal"), [0, 1], "contacts[0].normal", "a list of 3 numbers, not 2"),
    InvalidCase("ragged position", ("contacts", 0, "position"), [0, [1], 2], "contacts[0].position", "a list of 3 numbers"),
    InvalidCase("NaN in position", ("contacts", 0, "position"), [0, NAN, 0], "contacts[0].position[1]", "a finite number"),
    InvalidCase("parallel tangent", ("contacts", 0, "tangent"), [0, 2, 0], "contacts[0].tangent", "not parallel to the normal"),
    InvalidCase("unknown model", ("contacts", 0, "model"), "hard", "contacts[0].model", "one of frictionless, point, soft"),
    InvalidCase("soft without γ", ("contacts", 1, "torsional_friction"), REMOVED, "contacts[1].torsional_friction", "a finite"),
    InvalidCase("negative γ", ("contacts", 1, "torsional_friction"), -1, "contacts[1].torsional_friction", "at least 0"),
    InvalidCase(
        "min over max", ("contacts", 0, "min_normal"), 25.0, "contacts[0].min_normal", "at most max_normal, which is 20"
    ),
    InvalidCase("negative min", ("contacts", 0, "min_normal"), -1.0, "contacts[0].min_normal", "at least 0"),
    InvalidCase("infinite max", ("contacts", 0, "max_normal"), INF, "contacts[0].max_normal", "a finite number, at least 0"),
    InvalidCase("short wrench", ("wrench",), [0, 0, 1], "wrench", "a list of 6 numbers, not 3"),
    InvalidCase("infinite wrench", ("wrench", 2), INF, "wrench[2]", "a finite number"),
    InvalidCase("wrench of text", ("wrench",), ["0"] * 6, "wrench", "a list of 6 numbers"),
    InvalidCase("wrench absent", ("wrench",), None, "wrench", "a list of 6 numbers"),
    InvalidCase(
        "rows missing", ("hand", "jacobian"), [[0.1, 0.2]], "hand.jacobian", "one row for each of the 7 force components"
    ),
    InvalidCase("flat Jacobian", ("hand", "jacobian"), [0.1, 0.2], "hand.jacobian", "an array of n × n numbers, not 2"),
    InvalidCase("no Jacobian", ("hand", "jacobian"), REMOVED, "hand.jacobian", "given"),
    InvalidCase("unknown hand field", ("hand", "limits"), 1, "hand.limits", "absent: the known fields are jacobian"),
    InvalidCase("short bias", ("hand", "bias_torque"), [0.1], "hand.bias_torque", "a list of 2 numbers, not 1"),
    InvalidCase("crossed limits", ("hand", "torque_lower"), [0.8, 0], "hand.torque_lower[0]", "at most torque_upper[0]"),
    InvalidCase(
        "NaN limit", ("hand", "torque_upper"), [NAN, 1], "hand.torque_upper[0]", "a finite number, or null for no limit"
    ),
    InvalidCase("negative weight", ("hand", "torque_weight"), [1, -2], "hand.torque_weight[1]", "at least 0"),
    InvalidCase("unknown cone", ("cone",), {"type": "round"}, "cone.type", "one of exact, pyramid"),
    InvalidCase("two facets", ("cone",), {"type": "pyramid", "facets": 2}, "cone.facets", "an integer from 3 to 1024"),
    InvalidCase("half a facet", ("cone",), {"type": "pyramid", "facets": 4.5}, "cone.facets", "an integer from 3 to 1024"),
    InvalidCase("no side", ("cone",), {"type": "pyramid", "side": "left"}, "cone.side", "one of inner, outer"),
    InvalidCase("unknown objective", ("objective",), {"type": "power"}, "objective.type", "one of torque, force, max_normal"),
    InvalidCase(
        "weight elsewhere", ("objective",), {"type": "force", "force_weight": 1}, "objective.force_weight", "absent or 0"
    ),
    InvalidCase("torque without a hand", ("hand",), None, "objective.type", "force, max_normal, sum_normal or margin"),
    InvalidCase("name no text", ("name",), 3, "name", "text"),
]


def assert_names(message: str, field: str, allowed: str) -> None:
    """Assert that an error message names a field, and says what is allowed or that the field is missing or unknown."""
    if allowed == "given":
        assert message.startswith(f"Missing field '{field}'")
    elif allowed.startswith("absent: the known fields") or allowed == "absent":
        assert message.startswith(f"Unknown field '{field}'; ")
    else:
        assert message.startswith(f"{field} = ")
        assert f": must be {allowed}" in message


def invalid_records() -> list[tuple[InvalidCase, dict[str, Any]]]:
    """Return all invalid cases with their records."""
    invalid = []
    for fault in INVALID_CASES:
        record = fault.record()
        if fault.name == "torque without a hand":
            record["objective"] = {"type": "torque"}
        invalid.append((fault, record))
    return invalid
