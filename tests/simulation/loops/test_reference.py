"""Reference motions: consistent derivatives, and the given displacement."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graspforce import InvalidInput
from graspforce.contact.motion import BodyMotion
from graspforce.simulation.loops.reference import (
    combined_reference,
    constant_reference,
    linear_reference,
    rotation_reference,
    sine_reference,
)

START = BodyMotion([0.1, -0.2, 0.3], Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix())


@pytest.mark.parametrize(
    ("reference", "half"),
    [
        (constant_reference(START), np.zeros(6)),
        (linear_reference(START, [0.01, -0.02, 0.03], 0.8), np.array([0.01, -0.02, 0.03, 0.0, 0.0, 0.0])),
        (rotation_reference(START, [0.0, 3.0, 4.0], 0.5, 0.8), np.array([0.0, 0.0, 0.0, 0.0, 0.3, 0.4])),
        (sine_reference(START, [0.01, -0.02, 0.03], 0.8), np.zeros(6)),
        (
            combined_reference(
                linear_reference(START, [0.01, -0.02, 0.03], 0.8), rotation_reference(START, [0.0, 3.0, 4.0], 0.5, 1.6)
            ),
            np.array([0.01, -0.02, 0.03, 0.0, 0.15, 0.2]),
        ),
    ],
    ids=["constant", "linear", "rotation", "sine", "combined"],
)
def test_twist_and_acceleration_are_the_derivatives_of_the_pose(reference, half):
    """Central differences over 1e-5 s have errors of about 1e-9 in rates and 1e-6 in accelerations."""
    h = 1e-5
    for t in (2e-5, 0.1, 0.33, 0.55, 0.8 + 1e-3, 1.3):
        now, later, earlier = reference(t), reference(t + h), reference(t - h)
        turned = Rotation.from_matrix(later.R_HO @ earlier.R_HO.T).as_rotvec()
        moved = np.concatenate([later.p_HO - earlier.p_HO, turned]) / (2.0 * h)
        np.testing.assert_allclose(now.twist, moved, atol=1e-7)
        np.testing.assert_allclose(now.acceleration, (later.twist - earlier.twist) / (2.0 * h), atol=1e-5)
    np.testing.assert_allclose(reference(0.0).p_HO, START.p_HO)
    np.testing.assert_array_equal(reference(0.0).twist, np.zeros(6))
    np.testing.assert_allclose(reference(0.4).p_HO - START.p_HO, half[:3], atol=1e-12)
    turned = Rotation.from_matrix(reference(0.4).R_HO @ START.R_HO.T).as_rotvec()
    np.testing.assert_allclose(turned, half[3:], atol=1e-7)


def test_rotation_about_no_axis_is_rejected():
    with pytest.raises(InvalidInput, match="axis"):
        rotation_reference(START, [0.0, 0.0, 0.0], 0.5, 1.0)
