"""Actuation: defaults, limits, and the record of a problem file."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspforce import Actuation, InvalidInput

J = [[0.03, 0.0], [0.01, -0.02], [0.0, 0.05]]
ARRAYS = ("J", "tau_u", "lower", "upper", "weight")


def test_defaults_are_zero_bias_no_limit_and_unit_weight():
    actuation = Actuation(J)
    assert actuation.J.tolist() == J
    assert actuation.tau_u.tolist() == [0.0, 0.0]
    assert actuation.lower.tolist() == [-math.inf] * 2
    assert actuation.upper.tolist() == [math.inf] * 2
    assert actuation.weight.tolist() == [1.0, 1.0]


def test_arrays_are_read_only_copies():
    source = np.array(J)
    actuation = Actuation(source, upper=[0.7, None])
    source[0, 0] = 9.0
    assert actuation.J[0, 0] == 0.03
    assert not any(getattr(actuation, name).flags.writeable for name in ARRAYS)
    with pytest.raises(AttributeError):
        actuation.J = source


@given(st.integers(0, 12), st.integers(1, 6), st.data())
@settings(max_examples=40, deadline=None)
def test_reading_a_record_inverts_writing_it(k, n, data):
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    lower = data.draw(st.lists(st.one_of(st.none(), st.floats(-10, 0)), min_size=n, max_size=n))
    upper = data.draw(st.lists(st.one_of(st.none(), st.floats(0, 10)), min_size=n, max_size=n))
    actuation = Actuation(rng.normal(size=(max(k, 1), n)), rng.normal(size=n), lower, upper, rng.uniform(size=n))
    read = Actuation.from_dict(json.loads(json.dumps(actuation.to_dict(), allow_nan=False)))
    for name in ARRAYS:
        assert np.array_equal(getattr(read, name), getattr(actuation, name))


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"jacobian": [[1.0], [1.0, 2.0]]}, "hand.jacobian"),
        ({"jacobian": [1.0, 2.0]}, "hand.jacobian"),
        ({"jacobian": [[math.nan, 1.0]]}, "hand.jacobian[0][0]"),
        ({"jacobian": "J"}, "hand.jacobian"),
        ({"bias_torque": [0.0]}, "hand.bias_torque"),
        ({"bias_torque": [0.0, math.inf]}, "hand.bias_torque[1]"),
        ({"torque_lower": [0.0, 1.0]}, "hand.torque_lower[1]"),
        ({"torque_lower": [math.inf, 0.0]}, "hand.torque_lower[0]"),
        ({"torque_upper": [math.nan, 1.0]}, "hand.torque_upper[0]"),
        ({"torque_upper": [1.0]}, "hand.torque_upper"),
        ({"torque_upper": 0.7}, "hand.torque_upper"),
        ({"torque_weight": [1.0, -1e-9]}, "hand.torque_weight[1]"),
        ({"torque_weight": [1.0, True]}, "hand.torque_weight"),
        ({"torque_limit": [1.0, 1.0]}, "hand.torque_limit"),
    ],
)
def test_error_names_the_field_of_the_file(change, field):
    record = {"jacobian": J, "torque_lower": [-0.7, -0.7], "torque_upper": [0.7, 0.7]} | change
    with pytest.raises(InvalidInput) as caught:
        Actuation.from_dict(record)
    assert caught.value.field == field
    assert caught.value.allowed


def test_error_states_what_is_allowed():
    with pytest.raises(InvalidInput, match=r"^Missing field 'hand\.jacobian'$"):
        Actuation.from_dict({})
    with pytest.raises(InvalidInput, match=r"torque_lower\[0\] = 1\.0: must be at most torque_upper\[0\], which is 0\.5"):
        Actuation(J, lower=[1.0, 0.0], upper=[0.5, 0.5])
