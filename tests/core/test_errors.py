"""Texts of errors, and the class tree as the module docstring draws it."""

from __future__ import annotations

import builtins
import pickle
import re

import numpy as np
import pytest

from graspforce.core import errors
from graspforce.core.errors import (
    GraspForceError,
    InvalidInput,
    MissingField,
    UnknownField,
    UnknownName,
    format_value,
    nearest_name,
)


def test_class_tree_is_the_one_that_the_docstring_draws() -> None:
    """Every line of the drawing names a class below the base class that the drawing shows."""
    parents: list[type] = []
    drawn = re.findall(r"^([│ ]*)(?:[├└]── )?([A-Z]\w+)(?: \((\w+)\))?", errors.__doc__.split("\n\n", 1)[1], flags=re.M)
    for indent, name, other in drawn:
        depth = len(indent) // 4 + (name != "GraspForceError")
        cls = getattr(errors, name)
        assert issubclass(cls, parents[depth - 1] if depth else Exception)
        assert not other or issubclass(cls, getattr(builtins, other))
        parents[depth:] = [cls]
    classes = {name for name, value in vars(errors).items() if isinstance(value, type) and issubclass(value, GraspForceError)}
    assert classes == {name for _, name, _ in drawn}


def test_an_error_names_field_value_and_allowed_values() -> None:
    error = InvalidInput("friction", np.float64(-0.5), "at least 0")
    assert str(error) == "friction = -0.5: must be at least 0"
    assert str(error.with_prefix("contacts[2]")) == "contacts[2].friction = -0.5: must be at least 0"
    assert str(error.with_field("mu")) == "mu = -0.5: must be at least 0"
    assert InvalidInput("[1]", 0, "1").with_prefix("wrench").field == "wrench[1]"
    assert isinstance(UnknownName("hand", "x", ["y"]).with_prefix("request"), UnknownName)
    assert isinstance(error, ValueError)


def test_an_unknown_field_suggests_the_nearest_or_lists_all() -> None:
    known = ["position", "normal", "friction"]
    assert str(UnknownField("frictoin", 0.5, known)) == "Unknown field 'frictoin'; did you mean 'friction'?"
    assert str(UnknownField("zzz", 1, known)) == "Unknown field 'zzz'; known fields: position, normal, friction"
    nested = UnknownField("frictoin", 0.5, known).with_prefix("contacts[2]")
    assert str(nested) == "Unknown field 'contacts[2].frictoin'; did you mean 'friction'?"
    assert (nested.code, nested.field, nested.value, nested.known) == ("invalid", "contacts[2].frictoin", 0.5, tuple(known))


def test_a_missing_field_is_named_with_its_path() -> None:
    assert str(MissingField("wrench")) == "Missing field 'wrench'"
    assert str(MissingField("inertia", "required without a shape").with_prefix("body")) == (
        "Missing field 'body.inertia': required without a shape"
    )


def test_an_unknown_name_lists_the_known_ones_and_suggests_the_nearest() -> None:
    known = ["allegro_left", "four_finger"]
    assert str(UnknownName("hand", "four_fingr", known)) == (
        "hand = 'four_fingr': must be one of allegro_left, four_finger; did you mean 'four_finger'?"
    )
    assert str(UnknownName("hand", "x", known)) == "hand = 'x': must be one of allegro_left, four_finger"
    assert str(UnknownName("hand", "x", known, "a file")) == "hand = 'x': must be a file"
    assert str(UnknownName("stream", "s", (), "the id of an open stream")) == "stream = 's': must be the id of an open stream"
    assert UnknownName("hand", "x").code == "unknown"


@pytest.mark.parametrize(
    ("name", "nearest"),
    [("frictoin", "friction"), ("Friction", "friction"), ("mass", None), ("", None), (3, None), ("friction" * 100_000, None)],
)
def test_nearest_name_is_a_similar_one_or_none(name: object, nearest: str | None) -> None:
    assert nearest_name(name, ["friction", "normal"]) == nearest


@pytest.mark.parametrize(
    "error",
    [
        InvalidInput("a", 1, "at least 2"),
        MissingField("a", "always"),
        UnknownField("ab", 1, ["abc"]),
        UnknownName("a", "fore", ["four"], "a number"),
    ],
)
def test_errors_survive_pickling_and_a_prefix(error: InvalidInput) -> None:
    for same in (pickle.loads(pickle.dumps(error)), error.with_prefix(""), error.with_field(error.field)):
        assert type(same) is type(error)
        assert (str(same), same.args) == (str(error), error.args)


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
def test_values_appear_as_plain_python(value: object, text: str) -> None:
    assert format_value(value) == text


@pytest.mark.parametrize(
    "value", [list(range(10**6)), "x" * 10**6, {str(i): i for i in range(10**5)}, np.zeros((1000, 1000)), 10**400]
)
def test_large_values_are_cut(value: object) -> None:
    assert len(format_value(value)) <= 80
    assert re.search(r"\.\.\.|…", format_value(value))
