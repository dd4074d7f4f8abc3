"""The true grasp of a world touches, and its frame moves with the object."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.control_grasps import named_grasp

from graspforce.contact.contact import ContactModel
from graspforce.contact.motion import BodyMotion
from graspforce.simulation.worlds.true_grasp import read_true_grasp
from graspforce.simulation.worlds.world import World
from graspforce.simulation.worlds.world_plants import make_plant

WORLD = World(
    mass_factor=1.4, centre_offset=[0.0, 4e-3, -3e-3], friction_factor=0.7, pad_torsion=0.004, tip_offset=2e-3,
    shape_offset=1e-3, shape_turn=0.08, seed=6,
)  # fmt: skip


def read(grasp, world=WORLD):
    """Return the true grasp, its plant and the plant's options."""
    options = world.plant_options(grasp, PALM_UP)
    plant = make_plant(grasp, options)
    return read_true_grasp(plant, grasp, options), plant, options


@pytest.mark.parametrize("name", ["allegro ball", "allegro_right box"])
def test_true_fingers_touch_the_true_surface(name):
    """Within the penetration of the contacts; on the surface itself to half of it."""
    grasp = three_finger_grasp() if name == "allegro ball" else named_grasp(name)
    true, plant, _ = read(grasp)
    depth = plant.true_contacts().depth.max()
    assert true.grasp.contact_errors().max() < depth < 1e-4
    points = true.grasp.contacts.p_OC
    on_surface = grasp.body.shape.project_to_surface(points)
    assert np.linalg.norm(points - on_surface, axis=1).max() < depth
    np.testing.assert_allclose(true.grasp.contacts.R_OC[:, :, 2], grasp.body.shape.inward_normal(on_surface), atol=1e-6)


def test_true_contacts_deviate_as_the_world_says():
    """Fingertips 2 mm off turn a ball's normals by 2 mm / 42 mm at most, the moved surface by 1 mm / 42 mm."""
    grasp = three_finger_grasp()
    true, plant, options = read(grasp)
    told = grasp.R_HO @ grasp.contacts.R_OC[:, :, 2].T
    new = true.grasp.R_HO @ true.grasp.contacts.R_OC[:, :, 2].T
    angles = np.arccos(np.clip(np.sum(told * new, axis=0), -1.0, 1.0))
    assert 0.01 < angles.max() < 3 * (2e-3 + 1e-3) / 0.042  # rad; closing fingers may move on by as much again
    assert set(true.grasp.contacts.models) == {ContactModel.SOFT}
    np.testing.assert_allclose(true.grasp.contacts.mu, 0.7 * grasp.contacts.mu)
    np.testing.assert_allclose(true.grasp.contacts.gamma, 0.004)
    assert true.grasp.body.mass == pytest.approx(plant.model.body_mass[plant.scene.object_body])
    centre_O = true.p_OG + true.R_OG @ true.grasp.body.p_OM
    np.testing.assert_allclose(centre_O, plant.model.body_ipos[plant.scene.object_body], atol=1e-12)
    np.testing.assert_allclose(true.R_OG @ true.grasp.body.inertia @ true.R_OG.T, options.body.inertia, atol=1e-12)


def test_motion_of_the_surface_is_that_of_a_rigid_body():
    """Twist and acceleration of G are the derivatives of its pose, by central differences with an error of order h²."""
    true, _, _ = read(three_finger_grasp())
    omega, h = np.array([0.7, -1.1, 0.5]), 1e-4

    def motion(t: float) -> BodyMotion:
        R = Rotation.from_rotvec(omega * t**2).as_matrix()
        p = np.array([0.1 * t**2, 0.2 * t, 0.3])
        return BodyMotion(p, R, np.append([0.2 * t, 0.2, 0.0], 2 * omega * t), np.append([0.2, 0.0, 0.0], 2 * omega))

    t = 0.6
    before, at, after = (true.to_surface(motion(t + k * h)) for k in (-1, 0, 1))
    np.testing.assert_allclose((after.p_HO - before.p_HO) / (2 * h), at.twist[:3], atol=1e-9)
    np.testing.assert_allclose((after.p_HO - 2 * at.p_HO + before.p_HO) / h**2, at.acceleration[:3], atol=1e-6)
    turned = Rotation.from_matrix(after.R_HO @ before.R_HO.T).as_rotvec()
    np.testing.assert_allclose(turned / (2 * h), at.twist[3:], atol=1e-7)
    np.testing.assert_allclose((after.twist[3:] - before.twist[3:]) / (2 * h), at.acceleration[3:], atol=1e-9)
