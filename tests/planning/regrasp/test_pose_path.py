"""Paths through poses: ends, legs, and motions that are the derivatives of the pose."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graspforce.core.errors import InvalidInput
from graspforce.planning.regrasp import PosePath
from graspforce.planning.regrasp.pose_path import LENGTH_PER_RADIAN

START = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()


@pytest.mark.parametrize("angle", [0.3, -1.0, np.pi, 2.0 * np.pi, -5.0])
def test_turn_ends_at_the_angle_and_counts_radians(angle: float) -> None:
    axis = np.array([1.0, 2.0, -0.5])
    path = PosePath.turn([0.1, 0.0, 0.2], START, axis, angle)
    assert path.length == pytest.approx(abs(angle), abs=1e-12)
    for share in (0.0, 0.3, 1.0):
        motion = path.motion(share * path.length)
        turned = Rotation.from_rotvec(share * angle * axis / np.linalg.norm(axis)).as_matrix() @ START
        np.testing.assert_allclose(motion.R_HO, turned, atol=1e-12)
        np.testing.assert_allclose(motion.p_HO, [0.1, 0.0, 0.2])


def test_twist_is_the_derivative_of_the_pose() -> None:
    """Central differences over u of a path with two legs, at places inside the legs."""
    turned = Rotation.from_rotvec([0.0, 0.4, 0.1]).as_matrix() @ START
    path = PosePath(np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.02], [0.01, 0.03, 0.02]]), np.array([START, turned, START]))
    step, rate = 1e-6, 0.7
    for u in (0.2 * path.knots[1], 0.5 * (path.knots[1] + path.knots[2])):
        before, after = path.motion(u - step), path.motion(u + step)
        twist = path.motion(u, rate).twist
        np.testing.assert_allclose(twist[:3], rate * (after.p_HO - before.p_HO) / (2.0 * step), atol=1e-8)
        omega = Rotation.from_matrix(after.R_HO @ before.R_HO.T).as_rotvec() / (2.0 * step)
        np.testing.assert_allclose(twist[3:], rate * omega, atol=1e-8)


def test_displacement_counts_by_the_length_of_a_radian() -> None:
    path = PosePath(np.array([[0.0, 0.0, 0.0], [0.0, 0.06, 0.0]]), np.array([START, START]))
    assert path.length == pytest.approx(0.06 / LENGTH_PER_RADIAN)
    assert path.next_knot(0.1) == path.length


def test_invalid_paths_are_refused_by_field() -> None:
    half = Rotation.from_rotvec([0.0, 0.0, np.pi]).as_matrix() @ START
    with pytest.raises(InvalidInput, match=r"R_HO\[1\]"):
        PosePath(np.zeros((2, 3)), np.array([START, half]))
    with pytest.raises(InvalidInput, match=r"p_HO\[1\]"):
        PosePath(np.zeros((2, 3)), np.array([START, START]))
    with pytest.raises(InvalidInput, match="p_HO"):
        PosePath(np.zeros((1, 3)), np.array([START]))
    for distance in (10.1, 1e300):
        with pytest.raises(InvalidInput, match=r"p_HO\[1\].*at most 10 m"):
            PosePath(np.array([[0.0, 0.0, 0.0], [distance, 0.0, 0.0]]), np.array([START, START]))
    for wrong, field in (({"axis_H": [0.0, 0.0, 0.0]}, "axis_H"), ({"angle": 0.0}, "angle"), ({"angle": np.nan}, "angle")):
        with pytest.raises(InvalidInput, match=field):
            PosePath.turn(**{"p_HO": np.zeros(3), "R_HO": START, "axis_H": [0.0, 0.0, 1.0], "angle": 1.0, **wrong})
