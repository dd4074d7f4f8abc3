"""Checks of numbers: accepted values become read-only float64, errors name the field and the index."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from graspforce import InvalidInput
from graspforce.core import arrays

finite = npst.arrays(np.float64, npst.array_shapes(max_dims=3), elements=st.floats(allow_nan=False, allow_infinity=False))


@given(finite)
def test_an_accepted_array_is_an_equal_read_only_copy(value):
    result = arrays.check_array(value, "x", value.shape)
    assert result.dtype == np.float64
    assert np.array_equal(result, value)
    assert not result.flags.writeable
    assert not np.shares_memory(result, value)
    assert np.array_equal(arrays.check_array(value.tolist(), "x", (None,) * value.ndim), value)


@pytest.mark.parametrize("dtype", [np.int8, np.uint64, np.float16, np.float32])
def test_all_number_types_become_float64(dtype):
    assert arrays.check_array(np.array([1, 2, 3], dtype), "x", (3,)).dtype == np.float64


def test_freeze_copies():
    source = np.array([1.0, 2.0])
    result = arrays.freeze(source)
    source[0] = 5.0
    assert result.tolist() == [1.0, 2.0]
    with pytest.raises(ValueError, match="read-only"):
        result[0] = 3.0


@pytest.mark.parametrize(
    "value",
    [
        None,
        "text",
        b"ab",
        3.0,
        [1.0, 2.0],
        [1.0, 2.0, 3.0, 4.0],
        [[1.0, 2.0, 3.0]],
        [1.0, [2.0], 3.0],
        [1.0, None, 2.0],
        {"a": 1},
        ["1", "2", "3"],
        [True, False, True],
        [1.0, True, 0.0],
        [1j, 0, 0],
        [10**400, 0, 0],
        [np.bool_(True), 1.0, 2.0],
        object(),
    ],
)
def test_rejects_a_value_that_is_not_three_numbers(value):
    with pytest.raises(InvalidInput, match=r"^x = .*: must be a list of 3 numbers") as caught:
        arrays.check_array(value, "x", (3,))
    assert caught.value.field == "x"


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_the_error_names_the_index_of_a_number_that_is_not_finite(bad):
    with pytest.raises(InvalidInput) as caught:
        arrays.check_array([[1.0, 2.0], [3.0, bad]], "J", (None, 2))
    assert (caught.value.field, caught.value.allowed) == ("J[1][1]", "a finite number")
    assert str(caught.value.value) == str(bad)


def test_the_error_names_both_shapes():
    with pytest.raises(InvalidInput, match=r"an array of n × 3 numbers, not 2 × 2"):
        arrays.check_array(np.eye(2), "p", (None, 3))
    with pytest.raises(InvalidInput, match="not a single number"):
        arrays.check_array(1.0, "p", (3,))


def test_the_error_names_the_first_number_outside_the_range():
    assert arrays.check_array([0.0, 2.0], "k", (2,), minimum=0.0).tolist() == [0.0, 2.0]
    with pytest.raises(InvalidInput, match=r"^k\[1\]\[0\] = -1\.0: must be at least 0$"):
        arrays.check_array([[1.0], [-1.0]], "k", (2, 1), minimum=0.0)
    with pytest.raises(InvalidInput, match=r"^k\[0\] = 0\.0: must be greater than 0$"):
        arrays.check_array([0.0, -1.0], "k", (2,), above=0.0)


def test_none_stands_for_no_limit():
    assert arrays.check_limits(None, "u", 2, math.inf).tolist() == [math.inf, math.inf]
    assert arrays.check_limits([1.0, None], "u", 2, math.inf).tolist() == [1.0, math.inf]
    assert arrays.check_limits((None, -2), "l", 2, -math.inf).tolist() == [-math.inf, -2.0]
    assert arrays.check_limits(np.array([math.inf, 3.0]), "u", 2, math.inf).tolist() == [math.inf, 3.0]
    assert not arrays.check_limits([1.0], "u", 1, math.inf).flags.writeable


@pytest.mark.parametrize(
    ("value", "field"),
    [([1.0, math.nan], "u[1]"), ([-math.inf, 1.0], "u[0]"), ([1.0], "u"), ("no", "u"), (1.0, "u"), ([True, 1.0], "u")],
)
def test_the_error_names_the_invalid_limit(value, field):
    with pytest.raises(InvalidInput) as caught:
        arrays.check_limits(value, "u", 2, math.inf)
    assert caught.value.field == field


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2), np.int64(2), np.float64(2)])
def test_a_number_becomes_a_float(value):
    result = arrays.check_number(value, "m", minimum=2.0, above=1.0)
    assert type(result) is float
    assert result == 2.0


@pytest.mark.parametrize("value", [None, "2", True, np.bool_(True), [2.0], math.nan, math.inf, 10**400, 1j])
def test_rejects_a_value_that_is_not_a_finite_number(value: object) -> None:
    with pytest.raises(InvalidInput, match=r"^m = .*: must be a finite number, greater than 0$"):
        arrays.check_number(value, "m", above=0.0)
    with pytest.raises(InvalidInput, match=r"^m = .*: must be a finite number$"):
        arrays.check_number(value, "m")


@pytest.mark.parametrize("value", [-1e-300, 0.0])
def test_rejects_a_number_that_is_not_above_the_bound(value: float) -> None:
    with pytest.raises(InvalidInput, match=r"^m = .*: must be greater than 0$"):
        arrays.check_number(value, "m", above=0.0)


def test_bounds_are_inclusive_for_minimum_and_exclusive_for_above() -> None:
    assert arrays.check_number(0.0, "m", minimum=0.0) == 0.0
    assert arrays.check_number(5e-324, "m", above=0.0) == 5e-324
    with pytest.raises(InvalidInput, match=r"^m = 0\.4999: must be at least 0\.5$"):
        arrays.check_number(0.4999, "m", minimum=0.5)


@pytest.mark.parametrize("times", [[0.0], [0.1, 0.2], [0.0, 0.0], [0.0, 2.0, 1.0], [[0.0, 1.0]], [0.0, np.nan]])
def test_times_of_knots_increase_from_zero(times):
    np.testing.assert_array_equal(arrays.check_times([0.0, 0.5, 2.0], "t"), [0.0, 0.5, 2.0])
    with pytest.raises(InvalidInput, match="t"):
        arrays.check_times(times, "t")
