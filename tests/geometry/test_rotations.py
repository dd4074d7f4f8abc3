"""Rotations: logarithm against the exponential and SciPy, quaternions against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from graspforce.core.errors import InvalidInput
from graspforce.geometry.rotations import rotation_exp, rotation_from_quaternion, rotation_log

axes = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda a: np.linalg.norm(a) > 1e-3)
angles = st.one_of(
    st.floats(0.0, np.pi),
    st.sampled_from([0.0, 1e-300, 1e-12, 1e-8, 1e-5, np.pi / 2, np.pi - 1e-5, np.pi - 1e-8, np.pi - 1e-12]),
)


@given(axes, angles)
def test_the_exponential_of_the_logarithm_is_the_rotation(axis, angle):
    turn = angle * np.array(axis) / np.linalg.norm(axis)
    R = Rotation.from_rotvec(turn)
    log = np.array(rotation_log(R.as_matrix()))
    # A matrix determines θ to 1e-16 and the axis to 1e-16/sin(θ/2), hence the rotation vector to about 1e-15.
    np.testing.assert_allclose(Rotation.from_rotvec(log).as_matrix(), R.as_matrix(), atol=4e-15)
    assert np.linalg.norm(log) <= np.pi + 1e-15
    if angle < np.pi - 1e-7:  # closer to π, rounding may reverse the axis
        np.testing.assert_allclose(log, turn, atol=4e-15)
        np.testing.assert_allclose(log, R.as_rotvec(), atol=4e-15)


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3), np.array([0.6, -0.8, 0.0]), np.array([1.0, 2.0, -2.0]) / 3.0])
def test_the_logarithm_of_half_a_turn_is_plus_or_minus_pi_times_the_axis(axis):
    log = np.array(rotation_log(2.0 * np.outer(axis, axis) - np.eye(3)))
    assert np.linalg.norm(log) == pytest.approx(np.pi, abs=1e-15)
    np.testing.assert_allclose(np.abs(log @ axis), np.pi, atol=1e-14)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 1e-3), st.floats(-300.0, 300.0))
def test_a_quaternion_of_any_length_gives_its_rotation(numbers, exponent):
    q = np.array(numbers) * 10.0**exponent
    R = rotation_from_quaternion(q.tolist(), "q")
    np.testing.assert_allclose(R, Rotation.from_quat(numbers, scalar_first=True).as_matrix(), atol=4e-15)


@pytest.mark.parametrize("bad", [[0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, np.nan, 0.0, 0.0], "1000", None])
def test_rejects_a_quaternion_that_is_zero_or_not_four_numbers(bad):
    with pytest.raises(InvalidInput, match=r"^pose\.quaternion"):
        rotation_from_quaternion(bad, "pose.quaternion")


@given(axes, angles)
def test_the_exponential_equals_that_of_scipy(axis, angle):
    turn = 2.0 * angle * np.array(axis) / np.linalg.norm(axis)
    R = rotation_exp(turn)
    np.testing.assert_allclose(R, Rotation.from_rotvec(turn).as_matrix(), atol=2e-15)
    np.testing.assert_array_equal(rotation_exp(turn.tolist()), R)
