"""Parts of `benchmarks.every_hand`: an object held and moved by a hand with its drives, whose constants are wrong."""

from __future__ import annotations

import math
import zlib
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from benchmarks.mujoco_loop import EARTH, PALM_UP
from graspforce import GraspForceError, Hand
from graspforce.contact import friction
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, OutputFeedbackController
from graspforce.control.friction.friction_compensation import FrictionSettings
from graspforce.core.arrays import Array
from graspforce.estimation import SensorModel
from graspforce.geometry import Box, Cylinder, Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp, relax_idle_fingers, travel_limits
from graspforce.grasp.search.travel import TravelLimit
from graspforce.hand.descriptions.drive_description import DRIVE_MODES
from graspforce.hand.drives.drive import Drive
from graspforce.simulation import World, constant_reference, linear_reference, make_world_plant, simulate_measured
from graspforce.simulation.campaigns.outcome import judge_run

OBJECTS = {"ball": Sphere(0.03), "box": Box([0.05, 0.05, 0.05]), "cylinder": Cylinder(0.025, 0.08)}
MASS, FRICTION = 0.05, 0.7  # kg
TRAVEL, LEAST_TRAVEL, PERIOD = 0.005, 5e-4, 1.0  # m, and s
TORQUE_ERROR, STIFFNESS_ERROR, DRIVE_ERROR = 0.2, 0.3, 0.2
RATE, BEYOND_LIMITS = 500.0, 0.2  # Hz, and rad, of drives that no description states
SERVO_STIFFNESS, JAW_STIFFNESS = 5.0, 5000.0  # N·m/rad and N/m
SERVO_DAMPING = 0.5  # part of the critical damping
ENCODER_NOISE, JAW_NOISE = 1e-4, 1e-5  # rad and m
MARGIN = 0.5  # N


def drive_modes(hand_name: str) -> list[str]:
    """Return the drives to run a hand with: "ideal", and those of its description or all modes."""
    return ["ideal", *(DRIVE_MODES[1:] if Hand.load(hand_name).drives.is_ideal else ["described"])]


def measure(hand_name: str, mode: str, object_name: str, duration: float) -> dict[str, Any]:
    """Return the measured values of a run.

    Args:
        hand_name: name of a shipped hand.
        mode: drives, as `drive_modes` returns them.
        object_name: one of `OBJECTS`.
        duration: simulated time, s.
    """
    grasp, gravity_H = find_object_grasp(hand_name, object_name), gravity(hand_name)
    grasp = replace(grasp, hand=grasp.hand.with_drives(drives_of(grasp, mode)))
    slowest = float(grasp.hand.drives.values("rate").min())
    rate = 1000.0 / max(1, math.ceil(1000.0 / slowest))  # Hz, a part of the plant's rate
    sensors = SensorModel(encoder_noise=JAW_NOISE if has_jaws(grasp.hand) else ENCODER_NOISE, rate=rate)
    is_servo = "position" in grasp.hand.drives.modes
    errors = {} if mode == "ideal" else {"stiffness_error": STIFFNESS_ERROR, "torque_error": 0.0 if is_servo else TORQUE_ERROR}
    errors |= {} if mode == "ideal" else {"drive_error": DRIVE_ERROR}
    world = World(sensors=sensors, seed=zlib.crc32(hand_name.encode()), **errors)
    has_losses = bool((grasp.hand.drives.values("efficiency") < 1.0).any())
    compensation = FrictionSettings(rest_tolerance_linear=0.0, rest_tolerance_angular=0.0)  # the noise alone sets them
    friction_settings = compensation if has_losses else None
    base = ControlSettings(gravity_H=gravity_H, slip_margin=MARGIN, period=1.0 / rate, friction=friction_settings)
    settings = ControlSettings.for_sensors(sensors, base, drives=grasp.hand.drives)
    controller = OutputFeedbackController(grasp, settings.settings, sensors)
    kept: list[bool] = []

    def compare(plant: Any, command: Any) -> None:
        contacts = plant.true_contacts()
        margin = friction.slip_margin(contacts.f, contacts.mu, contacts.gamma)
        kept.append(bool((margin >= command.guaranteed_margin).all()))

    limit = farthest_travel(grasp)
    start = BodyMotion(grasp.p_HO, grasp.R_HO)
    reference = constant_reference(start)
    if limit.distance >= LEAST_TRAVEL:
        reference = linear_reference(start, limit.distance * limit.direction, PERIOD)
    run = simulate_measured(make_world_plant(world, grasp, gravity_H), controller, reference, duration, world, on_step=compare)
    outcome = judge_run(run)
    first = np.searchsorted(run.truth.t, min(1.0, 0.5 * duration))
    error = np.linalg.norm(run.motion_error[first:], axis=1)
    rms = 1e3 * float(np.sqrt(np.mean(error**2))) if len(error) else math.inf
    return {
        "result": outcome.result,
        "mode": sorted(set(grasp.hand.drives.modes))[0],
        "rms": rms,
        "kept": float(np.mean(kept)),
        "steps": len(kept),
        "travel": limit.distance if limit.distance >= LEAST_TRAVEL else 0.0,
        "limit": limit.reason,
        "message": outcome.message,
    }


@cache
def find_object_grasp(hand_name: str, object_name: str) -> Grasp:
    """Return the grasp of a hand, always the same.

    Args:
        hand_name: name of a shipped hand.
        object_name: one of `OBJECTS`.
    """
    body = Body.solid(OBJECTS[object_name], MASS)
    return relax_idle_fingers(find_grasp(Hand.load(hand_name), body, friction=FRICTION, gravity_H=gravity(hand_name)))


def gravity(hand_name: str) -> Array:
    """Return gravity in H with the palm up, m/s².

    Args:
        hand_name: name of a shipped hand.
    """
    return PALM_UP if hand_name.startswith("allegro") else EARTH


def with_errors(drive: Drive) -> Drive:
    """Return a drive with the errors of its constants that the simulated one has.

    Args:
        drive: drive of a description.
    """
    torque_error = 0.0 if drive.mode == "position" else TORQUE_ERROR
    return replace(drive, torque_error=torque_error, stiffness_error=STIFFNESS_ERROR)


def drives_of(grasp: Grasp, mode: Any) -> list[Drive]:
    """Return the drives that the controller of a run knows.

    Args:
        grasp: grasp of a hand with the drives of its description.
        mode: as `drive_modes` returns them.
    """
    described = grasp.hand.drives
    if mode == "described":
        return [with_errors(drive) for drive in described.joints]
    if mode == "ideal":  # as often and as late as the others
        return [Drive(rate=RATE if described.is_ideal else drive.rate, delay=drive.delay) for drive in described.joints]
    return generic_drives(grasp, mode)


def generic_drives(grasp: Grasp, mode: Any) -> list[Drive]:
    """Return drives of one mode with servos of the same stiffness and relative damping at every joint.

    Args:
        grasp: the posture at which the joints' inertias are taken.
        mode: mode of all drives.
    """
    inertias = np.diag(grasp.hand.mass_matrix(grasp.q)).tolist()  # kg·m², for jaws kg
    stiffness = JAW_STIFFNESS if has_jaws(grasp.hand) else SERVO_STIFFNESS
    return [
        with_errors(
            Drive(
                mode,
                torque_constant=1.0,
                stiffness=stiffness,
                damping=2.0 * SERVO_DAMPING * math.sqrt(stiffness * M),
                rate=RATE,
                beyond_limits=BEYOND_LIMITS,
            )
        )
        for M in inertias
    ]


def has_jaws(hand: Hand) -> bool:
    """Return whether a joint of a hand is prismatic, so that its units are N and m."""
    return any(link.is_prismatic for link in hand.tree().links)


def farthest_travel(grasp: Grasp) -> TravelLimit:
    """Return the direction in which the fingers can move the object farthest, up to 5 mm, and what ends it.

    Args:
        grasp: the grasp.
    """
    nothing = TravelLimit(np.array([0.0, 0.0, 1.0]), 0.0, "the contacts permit no translation")
    try:
        return max(travel_limits(grasp, TRAVEL), key=lambda each: each.distance, default=nothing)
    except GraspForceError as error:
        return replace(nothing, reason=str(error)[:100])
