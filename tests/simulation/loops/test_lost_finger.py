"""A finger loses its drive while it holds a box: the other fingers hold it, without them knowing it drops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.control_grasps import named_grasp

from graspforce import ContactSet, Hand
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController, OutputFeedbackController
from graspforce.core.arrays import Array
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import find_grasp
from graspforce.simulation import World, constant_reference, simulate_measured
from graspforce.simulation.plants.urdf_plant import UrdfPlant
from graspforce.simulation.worlds.world_plants import PLANT_NAMES, PlantName, make_world_plant

pytest.importorskip("mujoco")

LOSS, STEPS = 100, 500  # steps of 1 ms


def run(told: bool) -> Array:
    """Return the distance of the box from its place after each step, m. The second finger has no torque after the loss.

    Args:
        told: whether the controller is told of the loss.
    """
    grasp = named_grasp("four_finger box")
    plant, controller = UrdfPlant(grasp), ObjectController(grasp, ControlSettings())
    rest, dead = BodyMotion(grasp.p_HO, grasp.R_HO), list(grasp.hand.finger("finger_2").joints)
    first = controller.step(plant.reset(), rest)
    controller.reset()
    state, distances = plant.reset(first.f), []
    for k in range(STEPS):
        is_lost = k >= LOSS
        command = controller.step(state, rest, lost=["finger_2"] if is_lost and told else ())
        tau = np.array(command.tau)
        if is_lost:
            tau[dead] = 0.0
        assert not (told and command.forces_reused)
        state = plant.step(tau)
        distances.append(np.linalg.norm(state.object.p_HO - grasp.p_HO))
    return np.array(distances)


def test_box_is_held_after_the_loss_of_a_finger() -> None:
    distances = run(told=True)
    assert distances.max() < 1e-3  # m: the limp finger drags on the box until it has left it
    assert distances[-100:].max() < 2e-4  # the integral removes the rest with a time constant of 0.2 s


def test_box_is_lost_if_the_controller_does_not_know() -> None:
    assert run(told=False).max() > 0.01  # m


@pytest.mark.parametrize("plant_name", PLANT_NAMES)
def test_box_is_held_from_measurements_after_the_loss_of_a_finger(plant_name: PlantName) -> None:
    """The estimate does not use the limp fingertip, and the forces are those of the other fingers from the same period on."""
    grasp = named_grasp("four_finger box")
    world = World(drive_losses=(("finger_2", 1e-3 * LOSS),))
    plant, controller = make_world_plant(world, grasp, name=plant_name), OutputFeedbackController(grasp)
    warnings: list[tuple[str, ...]] = []
    still = constant_reference(BodyMotion(grasp.p_HO, grasp.R_HO))
    recording = simulate_measured(
        plant, controller, still, 1e-3 * STEPS, world, on_step=lambda _, command: warnings.append(command.warnings)
    )
    assert not recording.is_dropped
    assert not recording.truth.forces_reused.any()
    assert not any(warnings[:LOSS])
    assert all(each[0] == "finger_2 has lost its drive: the other fingers hold the object" for each in warnings[LOSS:])
    assert np.linalg.norm(recording.motion_error, axis=1).max() < 1e-3  # m, as with exact states


def test_two_soft_fingertips_hold_a_ball_after_the_loss_of_the_third() -> None:
    """The limp finger swings away through postures in which its fingertip could not follow the ball."""
    gravity_H = [0.0, 0.0, -9.81]
    grasp = find_grasp(Hand.load("four_finger"), Body.solid(Sphere(0.03), 0.05), friction=0.7, gravity_H=gravity_H)
    contacts = [replace(each, model="soft", torsional_friction=5e-3) for each in grasp.contacts.contacts]
    told = replace(grasp, contacts=ContactSet.stack(contacts))
    world = World(pad_torsion=5e-3, drive_losses=((grasp.fingers[0], 1e-3 * LOSS),))
    plant = make_world_plant(world, grasp, gravity_H)
    controller = OutputFeedbackController(told, ControlSettings(gravity_H=gravity_H))
    still = constant_reference(BodyMotion(grasp.p_HO, grasp.R_HO))
    recording = simulate_measured(plant, controller, still, 1e-3 * STEPS, world)
    assert not recording.is_dropped
    assert np.linalg.norm(recording.motion_error, axis=1).max() < 5e-4  # m: the limp finger drags on the ball at first
    assert recording.turn_error.max() < np.radians(1.0)
