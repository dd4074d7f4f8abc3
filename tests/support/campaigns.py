"""Controllers and references of campaigns, importable by worker processes."""

from __future__ import annotations

import os

from graspforce.contact.motion import BodyMotion
from graspforce.estimation import CameraModel, SensorModel
from graspforce.simulation import DirectController, Reference, World, constant_reference
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.simulated_runs import SETTINGS

CAMERA = CameraModel(rate=1000.0, latency=0.0, position_noise=1e-9, angle_noise=1e-9)
LABEL = "allegro ball"


def draw(seed: int, torque_limit: float) -> World:
    """Return a world with perfect sensors; odd seeds push the object away."""
    pushes = ((0.0, 0.0, 40.0, 0.01, 0.1),) if seed % 2 else ()
    return World(sensors=SensorModel(has_velocity=True, camera=CAMERA), pushes=pushes, seed=seed)


def still(grasp) -> Reference:
    return constant_reference(BodyMotion(grasp.p_HO, grasp.R_HO))


def direct(grasp, settings, sensors) -> DirectController:
    return DirectController(grasp, settings)


class RaisingController(DirectController):
    """A controller that fails after 50 ms."""

    def step(self, measurement, desired, lost=()):
        if measurement.t > 0.05:
            raise ZeroDivisionError("a fault of the controller")
        return super().step(measurement, desired)


class CrashingController(DirectController):
    """A controller that ends its process after 20 ms."""

    def step(self, measurement, desired, lost=()):
        if measurement.t > 0.02:
            os._exit(3)
        return super().step(measurement, desired)


def raising(grasp, settings, sensors) -> RaisingController:
    return RaisingController(grasp, settings)


def crashing(grasp, settings, sensors) -> CrashingController:
    return CrashingController(grasp, settings)


def campaign_setup(**changes) -> dict:
    """Return the arguments of a `CampaignSetup` with short runs."""
    return {
        "grasps": ((LABEL, three_finger_grasp()),),
        "controller": direct,
        "reference": still,
        "duration": 0.1,
        "settings": SETTINGS,
        "draw": draw,
        **changes,
    }


__all__ = ["LABEL", "PALM_UP", "campaign_setup", "crashing", "direct", "draw", "raising", "still"]
