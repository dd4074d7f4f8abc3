"""Disturbances: pushes, mass and friction changes, lost contacts, failed motors."""

from __future__ import annotations

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.simulated_runs import free_body_plant, holding_torques

from graspforce import InvalidInput
from graspforce.core.errors import UnknownName
from graspforce.simulation.plants.disturbance import ContactLoss, FrictionChange, MassChange, MotorFailure, Push
from graspforce.simulation.plants.plant import Plant
from graspforce.simulation.plants.scene import build_scene


def test_push_moves_a_free_body_by_its_impulse():
    """m Δv_M = F T and Δ(I ω) = (r − c) × F T, from rest, in a time without much rotation."""
    force, point = np.array([0.3, -0.2, 0.5]), np.array([0.002, 0.005, -0.004])
    plant = free_body_plant(disturbances=[Push(force, 0.002, 0.003, point)])
    body, rest = plant.scene.grasp.body, np.zeros(plant.scene.grasp.hand.n)
    for _ in range(10):
        plant.step(rest)
    now = plant.object_motion()
    R_HO = plant.scene.grasp.R_HO
    spin = np.linalg.solve(R_HO @ body.inertia @ R_HO.T, np.cross(R_HO @ (point - body.p_OM), force)) * 0.003  # rad/s
    np.testing.assert_allclose(now.twist[3:], spin, rtol=3e-3)  # the rotation is 0.003 rad
    of_mass_centre = now.twist[:3] + np.cross(now.twist[3:], now.R_HO @ body.p_OM)  # m/s
    np.testing.assert_allclose(of_mass_centre, force * 0.003 / body.mass, rtol=1e-4)


def test_mass_change_scales_the_acceleration():
    push = Push([0.0, 0.0, 0.1], 0.0, 1.0)
    plain, loaded = free_body_plant(disturbances=[push]), free_body_plant(disturbances=[MassChange(2.0, 0.005), push])
    rest = np.zeros(plain.scene.grasp.hand.n)
    for k in range(10):
        before = [p.object_motion().twist for p in (plain, loaded)]
        plain.step(rest), loaded.step(rest)
        gained = [p.object_motion().twist - v for p, v in zip((plain, loaded), before, strict=True)]
        factor = 1.0 if k < 5 else 2.0
        np.testing.assert_allclose(gained[0], factor * gained[1], rtol=1e-2)  # the object rotates a little
    loaded.reset(np.zeros(3))
    assert loaded.model.body_mass[loaded.scene.object_body] == pytest.approx(0.1)


def test_friction_changes_linearly_and_stays():
    change = FrictionChange(0.4, 0.002, 0.004, "middle")
    plant = Plant(build_scene(three_finger_grasp(), gravity_H=PALM_UP), disturbances=[change])
    seen, torques = [], holding_torques(plant)
    for _ in range(10):
        plant.step(torques())
        seen.append(plant.true_contacts().mu)
    seen = np.array(seen)
    np.testing.assert_allclose(seen[:, 1], [0.7, 0.7, 0.7, 0.625, 0.55, 0.475, 0.4, 0.4, 0.4, 0.4])
    np.testing.assert_allclose(seen[:, [0, 2]], 0.7)


def test_contact_opens_if_the_pull_exceeds_the_normal_force():
    grasp = three_finger_grasp()
    scene = build_scene(grasp, gravity_H=PALM_UP)
    pressing = Plant(scene).true_contacts().f[0, 2]  # N
    for factor, leaves in ((0.3, False), (1.5, True)):
        plant = Plant(scene, disturbances=[ContactLoss("index", factor * pressing, 0.0, 0.05)])
        torques = holding_torques(plant)
        for _ in range(15):
            plant.step(torques())
        assert plant.true_contacts().touching[0] == (not leaves)
    plant = Plant(scene, disturbances=[ContactLoss("ring", 1.0, 0.0, 0.05)])
    with pytest.raises(UnknownName, match="index, middle, thumb"):
        plant.step(holding_torques(plant)())


def test_failed_motor_has_no_torque():
    plant = free_body_plant(disturbances=[MotorFailure("finger_1_joint_2", 0.002)])
    hand = plant.scene.grasp.hand
    i = [joint.name for joint in hand.joints].index("finger_1_joint_2")
    for k in range(4):
        plant.step(np.full(hand.n, 0.01))
        assert plant.true_contacts().tau[i] == (0.01 if k < 2 else 0.0)
        assert np.delete(plant.true_contacts().tau, i) == pytest.approx(0.01)
    with pytest.raises(UnknownName, match="finger_1_joint_1"):
        free_body_plant(disturbances=[MotorFailure("elbow", 0.0)]).step(np.zeros(hand.n))


def test_invalid_disturbances_are_rejected():
    for make in (
        lambda: Push([0.0, 0.0, np.nan], 0.0, 1.0),
        lambda: Push([0.0, 0.0, 1.0], -1.0, 1.0),
        lambda: MassChange(0.0, 1.0),
        lambda: FrictionChange(-0.1, 0.0),
        lambda: ContactLoss("index", -1.0, 0.0, 1.0),
        lambda: MotorFailure("x", 0.0, float("nan")),
    ):
        with pytest.raises(InvalidInput):
            make()
    heavy = three_finger_grasp(mass=20.0)
    with pytest.raises(InvalidInput, match="cannot hold"):
        Plant(build_scene(heavy, gravity_H=PALM_UP))
