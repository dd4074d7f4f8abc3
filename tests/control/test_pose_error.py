"""Pose error, and the limit on its integral."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from graspforce.contact.motion import BodyMotion
from graspforce.control.pose_error import limit_integral, pose_error

axes = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda a: np.linalg.norm(a) > 1e-3)


@given(axes, st.floats(1e-6, 3.0), axes)
def test_pose_error_is_the_constant_twist_that_reaches_the_desired_pose_in_one_second(axis, angle, start):
    """R_d = exp(ê) R: a rotation with the angular velocity e in H for one second."""
    rotation = angle * np.array(axis) / np.linalg.norm(axis)
    R = Rotation.from_rotvec(np.array(start))
    measured = BodyMotion([0.1, 0.2, 0.3], R.as_matrix())
    desired = BodyMotion([0.4, 0.1, 0.35], (Rotation.from_rotvec(rotation) * R).as_matrix())
    np.testing.assert_allclose(pose_error(desired, measured), [0.3, -0.1, 0.05, *rotation], atol=1e-14)


def test_limited_integral_keeps_its_direction_within_its_limits():
    gain = np.array([8.0, 8.0, 8.0, 2.0, 2.0, 2.0])
    small = np.array([0.1, -0.2, 0.2, 0.0, 0.0, 1.0])
    assert limit_integral(small, gain, (2.5, 2.1)) is small  # 8·0.3 and 2·1 are within the limits
    long = np.array([3.0, 0.0, 4.0, 0.0, 6.0, -8.0])
    np.testing.assert_allclose(limit_integral(long, gain, (4.0, 5.0)), [0.3, 0.0, 0.4, 0.0, 1.5, -2.0], rtol=1e-15)
    np.testing.assert_array_equal(long, [3.0, 0.0, 4.0, 0.0, 6.0, -8.0])  # the argument is unchanged
    np.testing.assert_array_equal(limit_integral(long, np.zeros(6), (0.0, 0.0)), long)  # no gain, no limit
