"""Preload: contacts carry the given forces from the first step."""

from __future__ import annotations

import numpy as np
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.hands import load

from graspforce import Contact, ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.plants.plant import Plant
from graspforce.simulation.plants.scene import build_scene

EARTH = (0.0, 0.0, -9.81)


def _balance(grasp, f):
    """Return G, and the difference between G f and the weight."""
    bases = grasp.contacts.wrench_bases()
    G = bases.transpose(1, 0, 2).reshape(6, -1)[:, grasp.contacts.columns]
    return G, G @ f - grasp.body.wrench(BodyMotion(grasp.p_HO, grasp.R_HO), PALM_UP)


def test_reset_preloads_contacts_with_the_given_forces():
    grasp = three_finger_grasp()
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP))
    f = 2.0 * plant.true_contacts().f.ravel()[grasp.contacts.columns]
    f -= np.linalg.lstsq(*_balance(grasp, f), rcond=None)[0]
    state = plant.reset(f)
    np.testing.assert_allclose(plant.true_contacts().f[:, :3].ravel(), f, atol=0.01 * np.abs(f).max())
    np.testing.assert_array_equal(state.object.p_HO, grasp.p_HO)
    np.testing.assert_array_equal(state.v, 0.0)
    assert plant.t == 0.0


def test_structural_forces_act_from_the_first_step():
    """Planar fingers on a ball, with normals up to 50° out of their planes: the structure carries load, and no tip slips."""
    hand, ball, fingers = load("anthropomorphic15"), Sphere(0.043), ("thumb", "index", "little")
    q = [
        0.5820,
        1.3894,
        0.0616,
        0.4106,
        1.6570,
        0.4745,
        *np.full(6, 0.08),
        0.6934,
        0.1410,
        0.9450,
    ]  # rad
    p_HO = np.array([0.05586, 0.01637, 0.06903])  # m
    closest_points = ball.project_to_surface(np.array([hand.tip_pose(q, name)[0] for name in fingers]) - p_HO)
    contacts = ContactSet.stack([Contact(p, -p, 0.8, max_normal=20.0) for p in closest_points])
    grasp = Grasp(hand, Body.solid(ball, 0.01), fingers, contacts, q, p_HO, np.eye(3))
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO).reshape(
        len(grasp.fingers), 3, -1
    )
    across = np.linalg.svd(J)[0][:, :, 2]  # normals of the fingers' planes, in the contact frames
    assert np.abs(across[:, 2]).max() > 0.5
    controller, desired = ObjectController(grasp, ControlSettings(gravity_H=EARTH)), BodyMotion(grasp.p_HO, grasp.R_HO)
    plant = Plant(build_scene(grasp, gravity_H=EARTH))
    first = controller.step(plant.state(), desired)
    assert np.linalg.norm(first.structural_wrench[:3]) > 0.1  # N
    state = plant.reset(first.f)
    np.testing.assert_allclose(plant.true_contacts().f[:, :3].ravel(), first.f, atol=0.01 * first.f.max())
    controller.reset()
    away, least = [], []
    for _ in range(100):
        state = plant.step(controller.step(state, desired).tau)
        true_contacts = plant.true_contacts()
        away.append(np.linalg.norm(state.object.p_HO - grasp.p_HO))
        least.append((true_contacts.mu * true_contacts.f[:, 2] - np.hypot(true_contacts.f[:, 0], true_contacts.f[:, 1])).min())
    assert max(away) < 2e-6  # m; 190e-6 if the tips slip
    assert min(least) > 0.9 * first.slip_margin.min()
