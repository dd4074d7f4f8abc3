"""A finger loses its drive while it holds a box: the other fingers hold it, without them knowing it drops."""

from __future__ import annotations

import numpy as np
import pytest
from support.control_grasps import named_grasp

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.core.arrays import Array
from graspforce.simulation.urdf_plant import UrdfPlant

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
