"""First-order distances from the faces of curved shapes, against exact ones."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from graspforce.geometry import Box, Cylinder, Solid, Sphere, Superquadric, TriangleMesh
from graspforce.grasp.search.faces import face_distances, face_tangents, rough_face_distances

_BALL = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
CURVED: dict[str, Solid] = {
    "ellipsoid": Superquadric((0.02, 0.03, 0.04), (1.0, 1.0)),
    "rounded box": Superquadric((0.02, 0.03, 0.04), (0.6, 0.8)),
    "mesh of a ball": TriangleMesh(_BALL.vertices, _BALL.faces),
}


def points(count: int, distance: float) -> np.ndarray:
    """Return points around the shapes, m."""
    p = np.random.default_rng(1).normal(size=(count, 3))
    return distance * p / np.linalg.norm(p, axis=1)[:, None]


@pytest.mark.parametrize("name", CURVED)
def test_tangents_match_the_exact_distances_to_first_order(name: str) -> None:
    shape, p = CURVED[name], points(12, 0.05)
    tangents = face_tangents(shape, p)
    assert tangents is not None
    errors = []
    for step in (1e-4, 5e-5):  # m
        moved = p + step * points(12, 1.0)[::-1]
        exact, linear = face_distances(shape, moved), tangents.at(moved)
        errors.append([np.abs(exact.face_distance - linear.face_distance).max(), np.abs(exact.normal - linear.normal).max()])
    ratio = np.array(errors[0]) / np.array(errors[1])
    assert (ratio > 3.0).all()  # the error is of second order: four times smaller for half the step
    assert errors[0][0] < 1e-6


@pytest.mark.parametrize("shape", [Sphere(0.03), Cylinder(0.03, 0.08), Box((0.04, 0.05, 0.06))])
def test_primitives_need_no_tangents(shape: Solid) -> None:
    assert face_tangents(shape, points(4, 0.05)) is None
    p = points(4, 0.05)
    assert np.array_equal(rough_face_distances(shape, p).face_distance, face_distances(shape, p).face_distance)


@pytest.mark.parametrize("name", CURVED)
def test_rough_distances_are_exact_on_the_surface(name: str) -> None:
    x = CURVED[name].project_to_surface(points(20, 0.05))
    assert np.abs(rough_face_distances(CURVED[name], x).face_distance).max() < 1e-7
