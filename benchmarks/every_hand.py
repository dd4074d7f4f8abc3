"""Every shipped hand in the loop: what it holds, and how it follows along the directions that its fingers can move."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from benchmarks.mujoco_loop import EARTH, PALM_UP, Row, run
from graspforce import ContactSet, GraspForceError, Hand, simulation
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController
from graspforce.core.arrays import Array
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import TravelLimit, find_grasp, travel_limits
from graspforce.hand.description import shipped_hands
from graspforce.problems.objects import GraspObject, ist_objects

OBJECTS = ("big green ball", "large blue box, long side", "small red cylinder, side")  # of the IST object set
TRAVEL = 0.005  # m, either way: 10 mm peak to peak
BAR = 0.05  # mm RMS at 1 Hz, as is asked of Allegro


def palm_up_gravity(hand: str) -> Array:
    """Palm up."""
    return PALM_UP if hand.startswith("allegro") else EARTH


def static_holding() -> Iterator[Row]:
    """Every shipped hand holds a ball, a box and a cylinder for 10 s"""
    for name, grasp_object, grasp in _find_grasps():
        label = f"{name} holds the {grasp_object.name} ({1e3 * grasp_object.mass:.0f} g, μ = {grasp_object.friction}) for 10 s"
        if isinstance(grasp, Grasp):
            yield _static_row(label, grasp, 10.0, palm_up_gravity(name))
        else:
            yield Row(label, "held", grasp, False)


def sinusoid_tracking() -> Iterator[Row]:
    """Every shipped hand follows a sinusoid of 1 Hz along each way that its fingers can go"""
    for name, grasp_object, grasp in _find_grasps():
        if not isinstance(grasp, Grasp):
            continue
        for there, back in _opposite_pairs(travel_limits(grasp, TRAVEL)):
            amplitude = min(there.distance, back.distance)
            along = ", ".join(f"{x:.2f}" for x in there.direction)
            label = f"{name}, {grasp_object.name}, ±{1e3 * amplitude:.0f} mm at 1 Hz along ({along}): RMS"
            reason = there.reason or back.reason
            if amplitude == 0.0:
                yield Row(label, f"≤ {BAR} mm", reason, False)
                continue
            sine = amplitude * there.direction
            recording = run(grasp, 2.0, lambda start, d=sine: simulation.sine(start, d, 1.0), gravity_H=palm_up_gravity(name))
            metrics = simulation.compute_metrics(recording.since(1.0))
            measured = f"{1e3 * metrics.position_error_rms:.4f} mm, forces {100 * metrics.force_error:.2f} % off the plan"
            measured += f"; 5 mm is too far: {reason}" if reason else ""
            is_met = (
                1e3 * metrics.position_error_rms <= BAR
                and metrics.lost_contact_steps == metrics.slip_steps == 0
                and amplitude >= TRAVEL
            )
            yield Row(label, f"≤ {BAR} mm", measured, is_met)


def uncontrollable_directions() -> Iterator[Row]:
    """Report motions that planar fingers cannot make, with the force that the structure bears"""
    for name, grasp_object, grasp in _find_grasps():
        if not isinstance(grasp, Grasp):
            continue
        settings = ControlSettings(gravity_H=palm_up_gravity(name))
        at_rest = BodyMotion(grasp.p_HO, grasp.R_HO)
        state = GraspState(grasp.q, np.zeros(grasp.hand.n), at_rest)
        commands = [ObjectController(grasp, settings).step(state, at_rest.with_acceleration(_along(axis))) for axis in range(3)]
        blocked = [
            f"{'xyz'[axis]} {np.linalg.norm(commands[axis].acceleration[:3] - _along(axis)[:3]):.0%}" for axis in range(3)
        ]
        if not len(commands[0].uncontrollable):
            continue
        bears = np.linalg.norm(commands[0].structural_wrench[:3])
        measured = f"{len(commands[0].uncontrollable)} twists cannot be made; refused of 1 m/s² along {', '.join(blocked)}; "
        measured += f"the structure bears {bears:.2f} N"
        yield Row(f"{name}, {grasp_object.name}: uncontrollable directions are reported", "reported", measured, True)


def all_gravity_directions() -> Iterator[Row]:
    """Hold a ball with the 15-joint hand in six palm orientations"""
    grasp = find_grasp(Hand.load("anthropomorphic15"), Body.solid(Sphere(0.03), 0.05), friction=0.7)
    for axis in range(3):
        for sign in (1.0, -1.0):
            label = f"anthropomorphic15 holds 50 g for 3 s, gravity along {'+' if sign > 0 else '-'}{'xyz'[axis]}"
            yield _static_row(label, grasp, 3.0, 9.81 * sign * np.eye(3)[axis])


def soft_fingertip_tracking() -> Iterator[Row]:
    """Fingertips that bear a moment about the normal, four joints behind each: what they follow, and what is refused before"""
    for name, grasp_object, points in _find_grasps():
        if name != "allegro_right" or not isinstance(points, Grasp):
            continue
        soft = [replace(each, model="soft", torsional_friction=0.005) for each in points.contacts.contacts]
        grasp = replace(points, contacts=ContactSet.stack(soft))
        for limit in travel_limits(grasp, TRAVEL):
            along = ", ".join(f"{x + 0.0:.0f}" for x in limit.direction)
            label = f"{name}, soft, {grasp_object.name}, {1e3 * limit.distance:.0f} mm and back along ({along}): RMS"
            if limit.distance == 0.0:
                yield Row(label.removesuffix(": RMS"), "refused before", limit.reason, True)
                continue
            there = limit.distance * limit.direction
            metrics = simulation.compute_metrics(
                run(grasp, 1.0, lambda start, d=there: simulation.linear_reference(start, d, 1.0))
            )
            measured = f"{1e3 * metrics.position_error_rms:.4f} mm, turned {np.degrees(metrics.orientation_error_peak):.3f}°"
            measured += f"; further is refused: {limit.reason}" if limit.reason else ""
            yield Row(
                label,
                f"≤ {BAR} mm",
                measured,
                1e3 * metrics.position_error_rms <= BAR and metrics.lost_contact_steps == metrics.slip_steps == 0,
            )


PARTS = (static_holding, sinusoid_tracking, uncontrollable_directions, all_gravity_directions, soft_fingertip_tracking)


def _along(axis: int) -> Array:
    """1 m/s² along an axis of H."""
    return np.eye(6)[axis]


@cache
def _find_grasps() -> tuple[tuple[str, GraspObject, Grasp | str], ...]:
    """Each hand with each thing, palm up, and the hold, or why there is none."""
    objects = {grasp_object.title: grasp_object for grasp_object in ist_objects()}
    found: list[tuple[str, GraspObject, Grasp | str]] = []
    for name in shipped_hands():
        for title in OBJECTS:
            grasp_object = objects[title]
            body = Body(grasp_object.mass, grasp_object.inertia, grasp_object.com, grasp_object.shape)
            grasp: Grasp | str
            try:
                grasp = find_grasp(Hand.load(name), body, friction=grasp_object.friction, gravity_H=palm_up_gravity(name))
            except GraspForceError as error:
                grasp = str(error)
            found.append((name, grasp_object, grasp))
    return tuple(found)


def _opposite_pairs(limits: tuple[TravelLimit, ...]) -> list[tuple[TravelLimit, TravelLimit]]:
    """Ways to and fro along one line, each line once."""
    pairs: list[tuple[TravelLimit, TravelLimit]] = []
    for limit in limits:
        if any(abs(limit.direction @ there.direction) > 0.999 for there, _ in pairs):
            continue
        back = [other for other in limits if limit.direction @ other.direction < -0.999]
        pairs.append((limit, back[0]))
    return pairs


def _static_row(label: str, grasp: Grasp, duration: float, gravity_H: Array) -> Row:
    """Still for a while: every finger touches, every force stays in its cone, and the object where it was."""
    try:
        metrics = simulation.compute_metrics(run(grasp, duration, gravity_H=gravity_H))
    except GraspForceError as error:
        return Row(label, "held", str(error), False)
    measured = f"{1e6 * metrics.position_error_peak:.2f} µm, {np.degrees(metrics.orientation_error_peak):.4f}°, "
    measured += f"motors {100 * metrics.max_torque_fraction:.0f} %"
    measured += f", {metrics.slip_steps} steps at the edge of friction" if metrics.slip_steps else ""
    is_met = (
        metrics.lost_contact_steps == metrics.slip_steps == 0
        and metrics.position_error_peak < 1e-3
        and metrics.orientation_error_peak < np.radians(1.0)
    )
    return Row(label, "held", measured, is_met)
