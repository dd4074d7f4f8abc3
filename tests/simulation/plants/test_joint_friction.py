"""Compensated joint friction in closed loop: the object follows, and rests without oscillation."""

from __future__ import annotations

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.simulated_runs import start_of

from graspforce import Hand
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController, OutputFeedbackController
from graspforce.control.friction.friction_compensation import FrictionSettings, friction_slip_margin
from graspforce.geometry import Box
from graspforce.grasp.body import Body
from graspforce.grasp.search import find_grasp
from graspforce.hand.drives.joint_friction import JointFriction
from graspforce.simulation import Recording, World, constant_reference, linear_reference, simulate, simulate_measured
from graspforce.simulation.plants.plant_options import PlantOptions
from graspforce.simulation.worlds.world_plants import make_plant, make_world_plant

EARTH = (0.0, 0.0, -9.81)  # m/s²
COULOMB = 0.1  # N·m in every joint
TRAVEL = np.array([0.005, 0.0, 0.0])  # m, end to end at 1 Hz


def run(friction: FrictionSettings | None, duration: float, rest_from: float = np.inf, stribeck: float = 0.0) -> Recording:
    """Move 50 g in three fingers whose joints have friction, and rest from a time on."""
    grasp = three_finger_grasp()
    plant = make_plant(grasp, PlantOptions(gravity_H=PALM_UP, coulomb=COULOMB, stribeck=stribeck))
    margin = 0.5 + (friction_slip_margin(grasp, COULOMB) if friction is None else 0.0)  # N; the compensation adds its own
    controller = ObjectController(grasp, ControlSettings(gravity_H=PALM_UP, slip_margin=margin, friction=friction))
    motion = linear_reference(start_of(grasp), TRAVEL, 1.0)
    rest = constant_reference(motion(rest_from))(0.0) if rest_from < duration else None
    return simulate(plant, controller, lambda t: motion(t) if rest is None or t < rest_from else rest, duration)


def rms(recording: Recording) -> float:
    """Return the RMS distance from the reference, m."""
    return float(np.sqrt(np.square(recording.position_error).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def uncompensated() -> Recording:
    return run(None, 1.0)


@pytest.mark.parametrize("factor", [0.8, None])
def test_object_follows_in_spite_of_friction(factor: float | None, uncompensated: Recording) -> None:
    """Known to 20 % or unknown, with the default gains, from the first motion on. The second half has converged."""
    model = None if factor is None else JointFriction(np.full(16, factor * COULOMB))
    recording = run(FrictionSettings(model), 1.0)
    bound = 0.8e-3 if factor is None else 0.4e-3  # m
    assert rms(recording) <= bound
    assert rms(recording.since(0.5)) <= 0.2 * rms(uncompensated.since(0.5))
    assert rms(uncompensated) > 1e-3
    assert recording.touching.all()


@pytest.mark.parametrize("stribeck", [0.0, 0.05])
def test_object_rests_without_oscillation(stribeck: float) -> None:
    """Peak to peak within 10 µm, though static friction exceeds Coulomb friction and the integral stays on."""
    resting = run(FrictionSettings(), 1.4, rest_from=0.5, stribeck=stribeck).since(0.9)
    assert np.ptp(resting.p_HO, axis=0).max() <= 1e-5


def test_fingers_do_not_slip_although_their_friction_is_unknown() -> None:
    """Friction of 0.05 N·m changes the forces of this grasp by 2 N. Without a margin for it, fingers slip."""
    hand = Hand.load("four_finger")
    grasp = find_grasp(hand, Body.solid(Box([0.05, 0.05, 0.05]), 0.05), friction=0.7, gravity_H=EARTH)
    world, start = World(joint_friction=0.05, joint_friction_spread=0.2), BodyMotion(grasp.p_HO, grasp.R_HO)
    sliding = []
    for friction in (FrictionSettings(), FrictionSettings(torque_error=0.0)):
        controller = OutputFeedbackController(grasp, ControlSettings(gravity_H=EARTH, friction=friction), world.sensors)
        plant = make_world_plant(world, grasp, EARTH)
        recording = simulate_measured(plant, controller, linear_reference(start, TRAVEL, 1.0), 0.3, world)
        sliding.append(1e3 * recording.sliding.max())  # mm
    assert sliding[0] < 0.05
    assert sliding[1] > 0.3
