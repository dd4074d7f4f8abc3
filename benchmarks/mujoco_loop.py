"""Closed loop in MuJoCo and rows of its tables, shared by the benchmarks of the controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from graspforce import simulation
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.core.arrays import Array
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.simulation import Plant, Recording

PALM_UP = np.array([-9.81, 0.0, 0.0])  # m/s², palm up for the Allegro hand, whose H has x out of the palm
EARTH = np.array([0.0, 0.0, -9.81])  # m/s², palm up for the other hands


@dataclass(frozen=True, slots=True)
class Row:
    """One row: a quantity, its requirement, the measured value, and whether the requirement is met."""

    label: str
    requirement: str
    measured: str
    is_met: bool


def run(
    grasp: Grasp,
    duration: float,
    reference: Callable[[BodyMotion], simulation.Reference] = simulation.constant_reference,
    *,
    gravity_H: Array = PALM_UP,
    body: Body | None = None,
    disturbances: tuple[simulation.Disturbance, ...] = (),
    tips: str = "ball",
    **settings: object,
) -> Recording:
    """Simulate the closed loop.

    Args:
        grasp: the grasp at the start.
        duration: simulated time, s.
        reference: function from the initial motion of the object to its reference.
        gravity_H: (3,) gravity in H, m/s².
        body: body of the plant, if it differs from that of the controller.
        disturbances: disturbances of the plant.
        tips: geometry of the fingertips: "ball" or "mesh".
        settings: fields of `ControlSettings`.
    """
    plant = Plant(simulation.build_scene(grasp, gravity_H=gravity_H, body=body, tip_geometry=tips), disturbances=disturbances)
    controller = ObjectController(grasp, replace(ControlSettings(gravity_H=gravity_H), **settings))  # type: ignore[arg-type]
    return simulation.simulate(plant, controller, reference(BodyMotion(grasp.p_HO, grasp.R_HO)), duration)
