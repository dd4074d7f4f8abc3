"""A loop closed in MuJoCo, and what was asked of it: shared by the benchmarks that judge the controller."""

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

PALM_UP = np.array([-9.81, 0.0, 0.0])  # m/s²: Allegro's H has x out of the palm
EARTH = np.array([0.0, 0.0, -9.81])  # m/s²: palm up, for the other hands


@dataclass(frozen=True, slots=True)
class Row:
    """One thing that was asked, the bar, and what came out."""

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
    """Close the loop about a hold."""
    plant = Plant(simulation.build_scene(grasp, gravity_H=gravity_H, body=body, tip_geometry=tips), disturbances=disturbances)
    controller = ObjectController(grasp, replace(ControlSettings(gravity_H=gravity_H), **settings))  # type: ignore[arg-type]
    return simulation.simulate(plant, controller, reference(BodyMotion(grasp.p_HO, grasp.R_HO)), duration)
