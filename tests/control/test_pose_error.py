"""The pose error, its logarithm and the bound on its integral."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from graspforce.contact.motion import BodyMotion
from graspforce.control.pose_error import limit_integral, pose_error, rotation_log

axes = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda a: np.linalg.norm(a) > 1e-3)
angles = st.one_of(
    st.floats(0.0, np.pi),
    st.sampled_from([0.0, 1e-300, 1e-12, 1e-8, 1e-5, np.pi / 2, np.pi - 1e-5, np.pi - 1e-8, np.pi - 1e-12]),
)


@given(axes, angles)
def test_the_logarithm_turns_back_into_the_rotation_and_is_scipy_s(axis, angle):
    turn = angle * np.array(axis) / np.linalg.norm(axis)
    R = Rotation.from_rotvec(turn)
    log = np.array(rotation_log(R.as_matrix()))
    # A matrix holds its angle to 1e-16 and its axis to 1e-16 over the angle's sine of half: no worse than 1e-15 all told.
    np.testing.assert_allclose(Rotation.from_rotvec(log).as_matrix(), R.as_matrix(), atol=4e-15)
    assert np.linalg.norm(log) <= np.pi + 1e-15
    if angle < np.pi - 1e-7:  # nearer to π rounding may turn the axis round
        np.testing.assert_allclose(log, turn, atol=4e-15)
        np.testing.assert_allclose(log, R.as_rotvec(), atol=4e-15)


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3), np.array([0.6, -0.8, 0.0]), np.array([1.0, 2.0, -2.0]) / 3.0])
def test_half_a_turn_has_its_axis_either_way_round(axis):
    log = np.array(rotation_log(2.0 * np.outer(axis, axis) - np.eye(3)))
    assert np.linalg.norm(log) == pytest.approx(np.pi, abs=1e-15)
    np.testing.assert_allclose(np.abs(log @ axis), np.pi, atol=1e-14)


@given(axes, st.floats(1e-6, 3.0), axes)
def test_the_error_is_the_constant_twist_in_h_that_leads_there_in_one_second(axis, angle, start):
    """R_d = exp(ê) R: turning with the angular velocity e, seen from H, for a second. And it is felt along H's axes."""
    turn = angle * np.array(axis) / np.linalg.norm(axis)
    R = Rotation.from_rotvec(np.array(start))
    now = BodyMotion([0.1, 0.2, 0.3], R.as_matrix())
    desired = BodyMotion([0.4, 0.1, 0.35], (Rotation.from_rotvec(turn) * R).as_matrix())
    np.testing.assert_allclose(pose_error(desired, now), [0.3, -0.1, 0.05, *turn], atol=1e-14)


def test_the_integral_keeps_its_direction_and_asks_no_more_than_its_limits():
    gain = np.array([8.0, 8.0, 8.0, 2.0, 2.0, 2.0])
    small = np.array([0.1, -0.2, 0.2, 0.0, 0.0, 1.0])
    assert limit_integral(small, gain, (2.5, 2.1)) is small  # 8·0.3 and 2·1: within
    long = np.array([3.0, 0.0, 4.0, 0.0, 6.0, -8.0])
    np.testing.assert_allclose(limit_integral(long, gain, (4.0, 5.0)), [0.3, 0.0, 0.4, 0.0, 1.5, -2.0], rtol=1e-15)
    np.testing.assert_array_equal(long, [3.0, 0.0, 4.0, 0.0, 6.0, -8.0])  # the caller's stays
    np.testing.assert_array_equal(
        limit_integral(long, np.zeros(6), (0.0, 0.0)), long
    )  # without a gain there is nothing to limit
