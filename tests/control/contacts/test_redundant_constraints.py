"""Grasps in which one contact constraint is nearly redundant: the object moves along it, and the controller must too."""

from __future__ import annotations

import numpy as np
import pytest
from support.control_grasps import redundant_dex3_grasp

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController, OutputFeedbackController
from graspforce.control.contacts.contact_constraints import ContactConstraints
from graspforce.estimation import SensorModel
from graspforce.geometry.rotations import rotation_log
from graspforce.grasp.grasp import Grasp
from graspforce.simulation import World, constant_reference, make_world_plant, simulate_measured

SETTINGS = ControlSettings(slip_margin=0.5)


def rest(grasp: Grasp) -> BodyMotion:
    return BodyMotion(grasp.p_HO, grasp.R_HO)


def test_noise_of_rates_does_not_grow_in_a_nearly_redundant_constraint():
    """[A, −B] of nine constraints has rank eight up to 1e-4. Accelerations change by at most the damping rate times noise."""
    grasp, rng, noise = redundant_dex3_grasp(), np.random.default_rng(2), 1e-3  # rad/s
    start = rest(grasp)
    still = ObjectController(grasp, SETTINGS).step(GraspState(grasp.q, np.zeros(grasp.hand.n), start), start)
    constraints = ContactConstraints.from_contacts(grasp.contacts)
    A, B, _ = constraints.constraint_rows(still._source.targets.rolling)
    size = np.linalg.svd(np.hstack([A, -B]))[1]
    assert size[-1] < 1e-3 * size[0] < size[-2]
    for _ in range(20):
        state = GraspState(grasp.q, noise * rng.standard_normal(grasp.hand.n), start)
        command = ObjectController(grasp, SETTINGS).step(state, start)
        # the damping rate of the gains is 80 1/s; tips and object differ in radius by a factor of some units
        assert np.abs(command.acceleration - still.acceleration).max() < 10.0 * 80.0 * noise


@pytest.mark.parametrize("noise", [1e-6, 1e-4])
def test_object_is_held_still_with_encoder_noise(noise):
    grasp = redundant_dex3_grasp()
    world = World(sensors=SensorModel(encoder_noise=noise), seed=3)
    controller = OutputFeedbackController(grasp, SETTINGS, world.sensors)
    run = simulate_measured(make_world_plant(world, grasp), controller, constant_reference(rest(grasp)), 0.3, world)
    assert not run.is_dropped
    assert not run.truth.warnings
    assert np.linalg.norm(rotation_log(run.truth.R_HO[-1] @ grasp.R_HO.T)) < 0.03  # rad; without control it grows to 0.1
    # noise of the joints at 0.1 m from the tips, for two tips 60 mm apart
    assert np.linalg.norm(run.motion_error, axis=1).max() < max(5.0 * 0.1 * noise, 2e-5)  # m
