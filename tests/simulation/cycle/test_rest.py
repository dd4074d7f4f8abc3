"""Rest of round objects on a table: the centre of mass is lowest, and the surface touches the table."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graspforce.geometry import Box, Sphere, Superquadric
from graspforce.geometry.rotations import rotation_exp
from graspforce.simulation.cycle.rest import is_stable, resting_pose
from graspforce.simulation.cycle.table_scene import rest_faces

DOWN = np.array([0.48, -0.6, 0.64])
TABLE = 0.02  # m along DOWN, of the table in H
SHAPES = [Sphere(0.03), Superquadric([0.025, 0.025, 0.035], [1.0, 1.0]), Superquadric([0.02, 0.03, 0.04], [0.7, 0.8])]


def surface(shape) -> np.ndarray:
    rng = np.random.default_rng(1)
    return shape.project_to_surface(0.05 * rng.standard_normal((4000, 3)))


def standing(shape, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a pose on the table with a face on which the object rests almost down."""
    rng = np.random.default_rng(seed)
    direction, height = rest_faces(shape)[0]
    upright = Rotation.align_vectors(DOWN[None], direction[None])[0].as_matrix()
    return (TABLE - height) * DOWN, rotation_exp(1e-3 * rng.standard_normal(3)) @ upright


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", range(3))
def test_centre_of_mass_is_lowest_at_rest(shape, seed):
    """V is not lower in any orientation near that of the rest; the sampled surface gives V to 0.1 mm."""
    rng = np.random.default_rng(seed)
    p_OM, points = 0.005 * rng.standard_normal(3), surface(shape)
    _, R = resting_pose(shape, p_OM, standing(shape, seed), DOWN)
    np.testing.assert_allclose(R.T @ R, np.eye(3), rtol=0, atol=1e-12)

    def height(R: np.ndarray) -> float:
        return float((points @ (R.T @ DOWN)).max() - p_OM @ R.T @ DOWN)

    others = [height(rotation_exp(0.05 * rng.standard_normal(3)) @ R) for _ in range(100)]
    assert height(R) <= min(others) + 1e-4


@pytest.mark.parametrize("shape", SHAPES)
def test_surface_touches_the_table_and_the_place_stays(shape):
    p_before, R_before = standing(shape, 0)
    p, R = resting_pose(shape, np.array([0.004, -0.003, 0.002]), (p_before, R_before), DOWN)
    lowest = ((surface(shape) @ R.T + p) @ DOWN).max()
    assert lowest == pytest.approx(TABLE, abs=2e-4)  # m: sampled surface
    assert np.linalg.norm(np.cross(p - p_before, DOWN)) < 1e-12


def test_ball_has_its_centre_of_mass_below_its_centre():
    p_OM = np.array([0.003, 0.004, -0.001])
    _, R = resting_pose(Sphere(0.03), p_OM, (np.zeros(3), np.eye(3)), DOWN)
    assert R @ p_OM == pytest.approx(np.linalg.norm(p_OM) * DOWN)


def test_box_stays_on_its_face():
    pose = np.zeros(3), np.eye(3)
    assert resting_pose(Box([0.04, 0.05, 0.06]), np.array([0.01, 0.0, 0.0]), pose, DOWN) is pose


def test_ellipsoid_is_stable_on_the_ends_of_its_shortest_axes_only():
    stable = [d for d in np.vstack([np.eye(3), -np.eye(3)]) if is_stable(Superquadric([0.025, 0.025, 0.035], [1.0, 1.0]), d)]
    assert np.allclose(np.abs(stable)[:, 2], 0.0)
    assert len(stable) == 4
