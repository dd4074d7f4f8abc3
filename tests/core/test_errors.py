"""What errors say, and that the tree is the one that is drawn."""

from __future__ import annotations

import re

import numpy as np
import pytest

from graspforce.core import errors
from graspforce.core.errors import GraspForceError, InvalidInput, UnknownName, format_value


def test_the_tree_is_as_drawn():
    """Every line of the drawing names a class, under the class that the drawing puts it under."""
    parents: list[type] = []
    drawn = re.findall(r"^([│ ]*)(?:[├└]── )?([A-Z]\w+)(?: \((\w+)\))?", errors.__doc__.split("\n\n", 1)[1], flags=re.M)
    for indent, name, other in drawn:
        depth = len(indent) // 4 + (name != "GraspForceError")
        cls = getattr(errors, name)
        assert issubclass(cls, parents[depth - 1] if depth else Exception)
        assert not other or issubclass(cls, ValueError)
        parents[depth:] = [cls]
    classes = {name for name, value in vars(errors).items() if isinstance(value, type) and issubclass(value, GraspForceError)}
    assert classes == {name for _, name, _ in drawn}


def test_an_error_names_field_value_and_what_is_allowed():
    error = InvalidInput("friction", np.float64(-0.5), "a finite number ≥ 0")
    assert str(error) == "friction = -0.5: must be a finite number ≥ 0"
    assert str(error.with_prefix("contacts[2]")) == "contacts[2].friction = -0.5: must be a finite number ≥ 0"
    assert InvalidInput("[1]", 0, "1").with_prefix("wrench").field == "wrench[1]"
    assert isinstance(UnknownName("hand", "x", "one of y").with_prefix("request"), UnknownName)
    assert isinstance(error, ValueError)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.array([1.0, 2.0]), "[1.0, 2.0]"),
        ((1, 2), "[1, 2]"),
        (None, "None"),
        ("0.5", "'0.5'"),
        (np.float64("nan"), "nan"),
        ([1, [2, 3]], "[1, [2, 3]]"),
    ],
)
def test_values_are_shown_plainly(value, text):
    assert format_value(value) == text


@pytest.mark.parametrize(
    "value", [list(range(10**6)), "x" * 10**6, {str(i): i for i in range(10**5)}, np.zeros((1000, 1000)), 10**400]
)
def test_large_values_are_cut(value):
    assert len(format_value(value)) <= 80
    assert re.search(r"\.\.\.|…", format_value(value))
