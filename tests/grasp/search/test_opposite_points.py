"""Opposite points: both are on the surface, and the normal of the first is nearly opposite to that of the second."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce.geometry import Box, Cylinder, Solid, Sphere
from graspforce.grasp.search.opposite_points import find_opposite_points, ray_widths

SHAPES: dict[str, Solid] = {
    "ball": Sphere(0.03),
    "pen": Cylinder(0.006, 0.15),
    "plate": Box([0.06, 0.014, 0.029]),
}


@pytest.mark.parametrize("name", SHAPES)
def test_both_points_are_on_the_surface_with_nearly_opposite_normals(name: str) -> None:
    shape = SHAPES[name]
    pairs = find_opposite_points(shape, np.random.default_rng(3), 100)
    second = pairs.first + pairs.width[:, None] * pairs.normal
    assert len(pairs.width) > 20
    assert np.abs(shape.phi(pairs.first)).max() < 1e-9
    assert np.abs(shape.phi(second)).max() < 1e-6
    np.testing.assert_allclose(shape.inward_normal(pairs.first), pairs.normal, atol=1e-9)
    outward = shape._gradient(shape.project_to_surface(second))
    cosine = (outward * pairs.normal).sum(axis=1) / np.linalg.norm(outward, axis=1)
    assert cosine.min() > 0.89


def test_widths_of_a_ball_and_of_a_plate_are_their_sizes() -> None:
    ball = find_opposite_points(SHAPES["ball"], np.random.default_rng(3), 50)
    np.testing.assert_allclose(ball.width, 0.06, atol=1e-6)
    plate = find_opposite_points(SHAPES["plate"], np.random.default_rng(3), 50)
    nearest = np.abs(plate.width[:, None] - [0.06, 0.014, 0.029]).min(axis=1)
    assert nearest.max() < 1e-6


def test_oblique_rays_have_no_opposite_point() -> None:
    point, direction = np.array([[0.0, 0.007, 0.0]]), np.array([[0.0, -1.0, 1.0]]) / np.sqrt(2.0)
    width, is_opposite = ray_widths(SHAPES["plate"], point, direction)
    assert width[0] == pytest.approx(0.014 * np.sqrt(2.0), abs=1e-6)
    assert not is_opposite[0]
