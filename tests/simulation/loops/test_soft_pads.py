"""Soft pads that the controller knows: it follows their spin where the fingers can, and keeps its posture where they cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP

from graspforce import Body, Hand, find_grasp
from graspforce.contact.contact import ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, OutputFeedbackController
from graspforce.geometry import Box
from graspforce.simulation import World, linear_reference, simulate_measured
from graspforce.simulation.worlds.world_plants import make_world_plant

TORSION = 0.0036  # m
PERIOD = 1.0  # s


@pytest.mark.parametrize("plant", ["links", "urdf"])
def test_a_box_that_pads_cannot_follow_is_held_for_a_period(plant: str) -> None:
    """The thumb meets a posture in which it cannot follow the spin. It comes back, and its links touch nothing."""
    grasp = find_grasp(Hand.load("allegro_right"), Body.solid(Box([0.05] * 3), 0.05), friction=0.7, gravity_H=PALM_UP)
    soft = [replace(each, model="soft", torsional_friction=TORSION) for each in grasp.contacts.contacts]
    world = World(pad_torsion=TORSION)
    settings = ControlSettings.for_sensors(world.sensors, ControlSettings(gravity_H=PALM_UP)).settings
    controller = OutputFeedbackController(replace(grasp, contacts=ContactSet.stack(soft)), settings, world.sensors)
    motion = linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), [0.005, 0.0, 0.0], PERIOD)
    run = simulate_measured(make_world_plant(world, grasp, PALM_UP, plant), controller, motion, PERIOD, world)
    assert not run.is_dropped
    assert run.sliding.max() < 3e-4  # m: a pad that spins by 0.1 rad creeps by some hundredths of a millimetre
    assert not run.truth.collisions
    assert np.abs(run.truth.q[-1] - grasp.q).max() < 0.12  # rad: 0.31 rad without the return
