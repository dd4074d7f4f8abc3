"""Drives that take set-points more rarely than the controller computes them."""

from __future__ import annotations

import numpy as np

from graspforce import Body, Hand, find_grasp
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, OutputFeedbackController
from graspforce.geometry import Box
from graspforce.simulation import World, linear_reference, simulate_measured
from graspforce.simulation.worlds.world_plants import make_world_plant

GRAVITY = [0.0, 0.0, -9.81]  # m/s² in H


def test_gains_are_stable_with_servos_that_take_90_set_points_a_second() -> None:
    grasp = find_grasp(Hand.load("leap_right"), Body.solid(Box([0.05] * 3), 0.05), friction=0.7, gravity_H=GRAVITY)
    assert grasp.hand.drives.longest_hold == 1.0 / 90.0
    world = World()
    motion = linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), [0.002, 0.0, 0.0], 0.5)
    settings = ControlSettings.for_sensors(world.sensors, ControlSettings(gravity_H=GRAVITY), drives=grasp.hand.drives).settings
    controller = OutputFeedbackController(grasp, settings, world.sensors)
    run = simulate_measured(make_world_plant(world, grasp, GRAVITY), controller, motion, 0.5, world)
    assert not run.is_dropped
    assert not run.truth.forces_reused.any()
    assert np.linalg.norm(run.motion_error, axis=1).max() < 2e-5  # m, of 2 mm
