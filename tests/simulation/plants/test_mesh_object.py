"""An object whose surface is a mesh: the plant and the controller hold it like the shape that the mesh approximates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.box_grasp import make_grasp
from support.meshes import box_mesh, torus_mesh

from graspforce.contact.motion import BodyMotion
from graspforce.control import ObjectController
from graspforce.core.errors import InvalidInput
from graspforce.geometry import TriangleMesh
from graspforce.simulation import Plant, build_scene, linear_reference, simulate

TRAVEL = (0.0, 0.0, 0.002)  # m


def final_pose(grasp):
    """Return where an object is after it was moved up and half-way back, m."""
    plant, controller = Plant(build_scene(grasp)), ObjectController(grasp)
    reference = linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), TRAVEL, 0.1)
    recording = simulate(plant, controller, reference, 0.075)
    return recording.p_HO[-1], recording.slip_margin.min()


def test_a_box_and_its_mesh_move_alike():
    grasp = make_grasp()
    mesh = TriangleMesh(*box_mesh(grasp.body.shape.edges))
    as_box, box_margin = final_pose(grasp)
    as_mesh, mesh_margin = final_pose(replace(grasp, body=replace(grasp.body, shape=mesh)))
    # MuJoCo finds contacts of meshes by iteration; its contacts yield by 20 µm per newton.
    np.testing.assert_allclose(as_mesh, as_box, atol=5e-6)
    assert np.isclose(mesh_margin, box_margin, atol=0.02)


def test_a_mesh_with_hollows_is_refused():
    grasp = make_grasp()
    mesh = TriangleMesh(*torus_mesh(0.04, 0.015, 24, 12))
    with pytest.raises(InvalidInput, match="convex mesh"):
        build_scene(replace(grasp, body=replace(grasp.body, shape=mesh)))
