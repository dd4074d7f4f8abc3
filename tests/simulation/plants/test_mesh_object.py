"""An object whose surface is a mesh: the plant and the controller hold it like the shape that the mesh approximates."""

from __future__ import annotations

import functools
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.box_grasp import make_grasp
from support.meshes import box_mesh, torus_mesh

from graspforce import Contact, ContactSet, Hand
from graspforce.contact.motion import BodyMotion
from graspforce.control import ObjectController
from graspforce.core.errors import InvalidInput
from graspforce.geometry import TriangleMesh
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.simulation import Plant, build_scene, linear_reference, simulate
from graspforce.simulation.plants.surface_contacts import update_positions

TRAVEL = (0.0, 0.0, 0.002)  # m
MAJOR, MINOR = 0.022, 0.008  # m, radii of a torus
OFFSET = np.array([0.004, -0.003, 0.006])  # m, of its centre from O


def final_pose(grasp):
    """Return where an object is after it was moved up and half-way back, m."""
    plant, controller = Plant(build_scene(grasp)), ObjectController(grasp)
    reference = linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), TRAVEL, 0.1)
    recording = simulate(plant, controller, reference, 0.075)
    return recording.p_HO[-1], recording.slip_margin.min()


@functools.cache
def torus():
    """Return the mesh of a torus about a point off its origin."""
    vertices, faces = torus_mesh(MAJOR, MINOR, 48, 24)
    return TriangleMesh(vertices + OFFSET, faces)


def torus_distance(p):
    """Return the distance of points from the torus, (N,), m."""
    x, y, z = (np.asarray(p) - OFFSET).T
    return np.hypot(np.hypot(x, y) - MAJOR, z) - MINOR


def torus_grasp():
    """Return a grasp of a torus by its outside."""
    hand, fingers, shape = Hand.load("four_finger"), ("finger_1", "finger_2", "finger_3", "finger_4"), torus()
    sides = [(0.04, 0.02), (0.04, -0.02), (-0.04, -0.02), (-0.04, 0.02)]
    points = shape.project_to_surface(OFFSET + np.array([(x, y, 0.0) for x, y in sides]))
    contacts = ContactSet.stack([Contact(p, n, 0.8) for p, n in zip(points, shape.inward_normal(points), strict=True)])
    p_HO = np.array([-0.004, 0.003, 0.055])
    q = hand.grasp_posture(fingers, contacts, p_HO, np.eye(3))
    return Grasp(hand=hand, body=Body.solid(shape, 0.05), fingers=fingers, contacts=contacts, q=q, p_HO=p_HO, R_HO=np.eye(3))


def test_a_box_and_its_mesh_move_alike():
    grasp = make_grasp()
    mesh = TriangleMesh(*box_mesh(grasp.body.shape.edges))
    as_box, box_margin = final_pose(grasp)
    as_mesh, mesh_margin = final_pose(replace(grasp, body=replace(grasp.body, shape=mesh)))
    np.testing.assert_allclose(as_mesh, as_box, atol=1e-8)  # flat faces are exact; Newton's method ends at 1e-9 of the size
    assert np.isclose(mesh_margin, box_margin, atol=1e-4)


def test_a_torus_follows_the_reference_like_a_box():
    """Contacts yield by 20 µm per newton; both objects end within 2 µm of each other."""
    grasp = torus_grasp()
    position, margin = final_pose(grasp)
    as_box, _ = final_pose(make_grasp())
    np.testing.assert_allclose(position - grasp.p_HO, as_box - make_grasp().p_HO, atol=2e-6)
    assert margin > 0.0


def place_freely(scene, data, rng):
    """Put the object at random near the fingertips, turned at random."""
    a = scene.object_q_address
    mujoco.mj_fwdPosition(scene.model, data)
    tip = data.geom_xpos[rng.choice(scene.tip_geoms)]
    R = Rotation.random(rng=rng)
    data.qpos[a : a + 3] = tip - R.apply(OFFSET) + rng.uniform(-0.025, 0.025, 3)
    data.qpos[a + 3 : a + 7] = R.as_quat(scalar_first=True)
    update_positions(scene.model, data, scene.surface)


def test_contacts_are_those_of_the_controllers_surface_and_of_the_torus():
    """Point, normal and distance are those of the smooth surface, and of the torus to 0.15 mm.

    24 facets around the tube deviate by r (1 − cos 7.5°) = 68 µm, 48 around the axis by (R + r) (1 − cos 3.75°) = 64 µm, and
    smoothing with h = 0.94 mm by h²/(6 r) = 18 µm.
    """
    scene = build_scene(torus_grasp())
    data, rng, shape = mujoco.MjData(scene.model), np.random.default_rng(1), scene.grasp.body.shape
    data.qpos[scene.q_address] = scene.T @ scene.grasp.q + scene.q0
    found, apart = 0, 0
    for _ in range(200):
        place_freely(scene, data, rng)
        R, p = data.xmat[scene.object_body].reshape(3, 3), data.xpos[scene.object_body]
        centres = (data.geom_xpos[list(scene.tip_geoms)] - p) @ R
        distances = torus_distance(centres) - scene.tip_radius
        for c in range(data.ncon):
            contact = data.contact[c]
            tip = scene.tip_index(contact)
            if tip is None or abs(distances[tip]) > MINOR:  # the tube's axis has no closest point
                continue
            found, apart = found + 1, apart + int(contact.exclude)
            assert bool(contact.exclude) == (contact.dist >= 0.0) == (contact.efc_address < 0)
            assert abs(contact.dist - distances[tip]) < 1.5e-4
            n = (
                contact.frame[:3]
                if scene.model.geom_type[contact.geom[0]] != mujoco.mjtGeom.mjGEOM_MESH
                else -contact.frame[:3]
            )
            on_surface = (contact.pos - p) @ R + 0.5 * contact.dist * (R.T @ n)
            assert abs(shape.phi(on_surface)) < 1e-9
            np.testing.assert_allclose(shape.inward_normal(on_surface), R.T @ n, atol=1e-6)
    assert found > 50
    assert apart > 10  # inside the hull, but not at the surface


def test_fingertips_in_a_hole_do_not_touch():
    grasp = torus_grasp()
    scene = build_scene(grasp)
    plant = Plant(scene)
    tip = plant.data.geom_xpos[scene.tip_geoms[0]]
    plant.place(grasp.q, tip - OFFSET, np.eye(3))  # the middle of the hole, 22 - 8 mm wide
    contacts = [c for c in range(plant.data.ncon) if scene.tip_index(plant.data.contact[c]) == 0]
    assert [bool(plant.data.contact[c].exclude) for c in contacts] == [True]
    assert not plant.true_contacts().touching[0]


def test_a_displaced_surface_is_where_the_world_puts_it():
    """A world moves the geom after the model is compiled; contacts follow it."""
    scene = build_scene(torus_grasp())
    data = mujoco.MjData(scene.model)
    data.qpos[scene.q_address] = scene.T @ scene.grasp.q + scene.q0
    mujoco.mj_fwdPosition(scene.model, data)
    before = scene.surface.distances(scene.model, data)
    shift = np.array([0.0, 0.0, 0.002])
    scene.model.geom_pos[scene.object_geom] += shift
    scene.model.geom_sameframe[scene.object_geom] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    mujoco.mj_fwdPosition(scene.model, data)
    centres = data.geom_xpos[list(scene.tip_geoms)] - scene.grasp.p_HO
    after = scene.surface.distances(scene.model, data)
    np.testing.assert_allclose(before, torus_distance(centres) - scene.tip_radius, atol=1.5e-4)
    np.testing.assert_allclose(after, torus_distance(centres - shift) - scene.tip_radius, atol=1.5e-4)


def test_fingertips_that_are_meshes_need_a_convex_object():
    with pytest.raises(InvalidInput, match='"ball" for a mesh that is not convex'):
        build_scene(torus_grasp(), tip_geometry="mesh")
