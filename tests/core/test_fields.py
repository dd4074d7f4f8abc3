"""Checks of plain records: errors name the path of a missing, unknown or invalid field."""

import numpy as np
import pytest

from graspforce import GraspForceError, InvalidInput
from graspforce.core import fields


def test_check_record_returns_a_copy():
    given = {"a": 1, "c": 3}
    result = fields.check_record(given, "r", required=["a"], optional=["b", "c"])
    assert result == given
    assert result is not given


def test_any_field_is_optional_if_optional_is_none():
    assert fields.check_record({"a": 1, "z": 2}, "r", required=["a"], optional=None) == {"a": 1, "z": 2}
    with pytest.raises(InvalidInput, match=r"^Missing field 'r\.a'$"):
        fields.check_record({"z": 2}, "r", required=["a"], optional=None)
    with pytest.raises(InvalidInput, match="a record"):
        fields.check_record([1], "r", optional=None)


def test_a_boolean_is_true_or_false():
    assert fields.check_boolean(True, "rolling") is True
    for value in (1, 0, None, "true", np.bool_(True)):
        with pytest.raises(InvalidInput, match=r"^rolling = .*: must be true or false$"):
            fields.check_boolean(value, "rolling")


@pytest.mark.parametrize(
    ("value", "where", "field", "allowed"),
    [
        ([1], "r", "r", "a record"),
        (None, "r", "r", "a record"),
        ({"a": 1, "z": 2}, "r", "r.z", "absent: the known fields are a, b"),
        ({"a": 1, "z": 2}, "", "z", "absent"),
        ({1: 2}, "", "1", "absent"),
        ({"b": 1}, "r", "r.a", "given"),
        ({}, "", "a", "given"),
    ],
)
def test_the_error_names_the_path_of_an_invalid_field(value, where, field, allowed):
    with pytest.raises(InvalidInput) as caught:
        fields.check_record(value, where, required=["a"], optional=["b"])
    assert caught.value.field == field
    assert allowed in caught.value.allowed


def test_sequences_have_a_minimum_length():
    assert fields.check_sequence((1, 2), "s", at_least=2) == [1, 2]
    for value in ([1], "ab", b"ab", None, {"a": 1}, 3):
        with pytest.raises(InvalidInput, match=r"^s = .*a list of at least 2"):
            fields.check_sequence(value, "s", at_least=2)


def test_a_choice_is_one_of_the_allowed_words():
    assert fields.check_choice("inner", "side", ["inner", "outer"]) == "inner"
    for value in ("Inner", "", None, 1, ["inner"]):
        with pytest.raises(InvalidInput, match=r"^side = .*one of inner, outer"):
            fields.check_choice(value, "side", ["inner", "outer"])


def test_text_must_be_a_str():
    assert fields.check_text("", "name") == ""
    with pytest.raises(InvalidInput, match=r"^name = 1: must be text"):
        fields.check_text(1, "name")


def test_integers_of_the_range_include_both_ends():
    for value in (3, 8, np.int32(5), np.uint8(8)):
        result = fields.check_integer(value, "m", minimum=3, maximum=8)
        assert type(result) is int
        assert result == value
    for value in (2, 9, 4.0, True, "4", None, np.float64(4)):
        with pytest.raises(InvalidInput, match=r"^m = .*an integer from 3 to 8"):
            fields.check_integer(value, "m", minimum=3, maximum=8)


def test_a_prefix_extends_the_path_and_the_error_is_a_value_error():
    error = InvalidInput("friction", -1, "at least 0").with_prefix("contacts[2]")
    assert str(error) == "contacts[2].friction = -1: must be at least 0"
    assert InvalidInput("[1]", 0, "x").with_prefix("axes").field == "axes[1]"
    assert InvalidInput("", 0, "x").with_prefix("axes").field == "axes"
    assert isinstance(error, ValueError)
    assert isinstance(error, GraspForceError)
