"""Grasps of superquadrics and meshes meet the requirements of those of spheres, cylinders and boxes."""

from __future__ import annotations

import numpy as np
import pytest
from support.meshes import sphere_mesh

from graspforce import Hand
from graspforce.contact.closure import is_force_closed
from graspforce.geometry import Sphere, Superquadric, TriangleMesh
from graspforce.grasp.body import Body
from graspforce.grasp.search import GraspSearchOptions, find_grasp
from graspforce.grasp.search.faces import face_distances

FINGERS = ("finger_1", "finger_2", "finger_4")
RADIUS = 0.03  # m
SHAPES = {
    "superquadric": Superquadric([0.03, 0.025, 0.035], [0.8, 0.9]),
    "mesh": TriangleMesh(*sphere_mesh(RADIUS, divisions=3), spacing=0.003),
}


@pytest.mark.parametrize("name", SHAPES)
def test_grasps_of_curved_shapes_touch_and_are_force_closed(name):
    hand, shape = Hand.load("four_finger"), SHAPES[name]
    options = GraspSearchOptions(travel=0.0)
    grasp = find_grasp(hand, Body.solid(shape, 0.05), FINGERS, friction=0.7, gravity_H=(0.0, 0.0, -9.81), options=options)
    np.testing.assert_allclose(grasp.contact_errors(), 0.0, atol=1e-8)  # m
    np.testing.assert_allclose(shape.inward_normal(grasp.contacts.p_OC), grasp.contacts.R_OC[:, :, 2], atol=1e-9)
    assert is_force_closed(grasp.contacts)
    if name == "mesh":  # a ball: contacts are on its radius to within chords (0.3 mm at 7.5 mm edges) and smoothing
        np.testing.assert_allclose(np.linalg.norm(grasp.contacts.p_OC, axis=1), RADIUS, atol=5e-4)


def test_distances_of_a_smooth_surface_are_those_along_its_normal():
    ball, mesh = Sphere(RADIUS), SHAPES["mesh"]
    p = np.random.default_rng(0).normal(size=(50, 3))
    p *= np.random.default_rng(1).uniform(0.8, 2.0, size=(50, 1)) * RADIUS / np.linalg.norm(p, axis=1)[:, None]
    exact, found = face_distances(ball, p), face_distances(mesh, p)
    np.testing.assert_allclose(found.face_distance, exact.face_distance, atol=5e-4)  # m: chords and smoothing
    assert (np.einsum("nfi,nfi->nf", found.normal, exact.normal) > np.cos(0.2)).all()  # facets of 14°
