"""Parts of `benchmarks.closed_loop` for every shipped hand: holding at rest, and tracking in the directions it can move."""

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
from graspforce.hand.descriptions.description import shipped_hands
from graspforce.problems.objects import GraspObject, ist_objects

OBJECTS = ("big green ball", "large blue box, long side", "small red cylinder, side")  # of the IST object set
TRAVEL = 0.005  # m, amplitude: 10 mm peak to peak
MAX_ERROR = 0.05  # mm RMS at 1 Hz, as for the Allegro hand


def palm_up_gravity(hand: str) -> Array:
    """Return gravity in H, m/s², with the palm up."""
    return PALM_UP if hand.startswith("allegro") else EARTH


def static_holding() -> Iterator[Row]:
    """Hold a ball, a box and a cylinder with every shipped hand for 10 s"""
    for name, grasp_object, grasp in _find_grasps():
        label = f"{name} holds the {grasp_object.name} ({1e3 * grasp_object.mass:.0f} g, μ = {grasp_object.friction}) for 10 s"
        if isinstance(grasp, Grasp):
            yield _static_row(label, grasp, 10.0, palm_up_gravity(name))
        else:
            yield Row(label, "held", grasp, False)


def sinusoid_tracking() -> Iterator[Row]:
    """Track a sinusoid of 1 Hz in each direction that the fingers of every shipped hand can move"""
    for name, grasp_object, grasp in _find_grasps():
        if not isinstance(grasp, Grasp):
            continue
        for there, back in _opposite_pairs(travel_limits(grasp, TRAVEL)):
            amplitude = min(there.distance, back.distance)
            along = ", ".join(f"{x:.2f}" for x in there.direction)
            label = f"{name}, {grasp_object.name}, ±{1e3 * amplitude:.0f} mm at 1 Hz along ({along}): position error, RMS"
            reason = there.reason or back.reason
            if amplitude == 0.0:
                yield Row(label, f"≤ {MAX_ERROR} mm", reason, False)
                continue
            sine = amplitude * there.direction
            recording = run(
                grasp, 2.0, lambda start, d=sine: simulation.sine_reference(start, d, 1.0), gravity_H=palm_up_gravity(name)
            )
            metrics = simulation.compute_metrics(recording.since(1.0))
            measured = f"{1e3 * metrics.position_error_rms:.4f} mm, contact-force error {100 * metrics.force_error:.2f} %"
            measured += f"; 5 mm infeasible: {reason}" if reason else ""
            is_met = (
                1e3 * metrics.position_error_rms <= MAX_ERROR
                and metrics.lost_contact_steps == metrics.slip_steps == 0
                and amplitude >= TRAVEL
            )
            yield Row(label, f"≤ {MAX_ERROR} mm", measured, is_met)


def uncontrollable_directions() -> Iterator[Row]:
    """Report the motions that planar fingers cannot make, and the structural force"""
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
        structural = np.linalg.norm(commands[0].structural_wrench[:3])  # N
        measured = f"{len(commands[0].uncontrollable)} uncontrollable twists; share of 1 m/s² that is not achieved: "
        measured += f"{', '.join(blocked)}; structural force {structural:.2f} N"
        yield Row(f"{name}, {grasp_object.name}: uncontrollable directions are reported", "reported", measured, True)


def all_gravity_directions() -> Iterator[Row]:
    """Hold a ball with the 15-joint hand in six orientations of gravity"""
    grasp = find_grasp(Hand.load("anthropomorphic15"), Body.solid(Sphere(0.03), 0.05), friction=0.7)
    for axis in range(3):
        for sign in (1.0, -1.0):
            label = f"anthropomorphic15 holds 50 g for 3 s, gravity along {'+' if sign > 0 else '-'}{'xyz'[axis]}"
            yield _static_row(label, grasp, 3.0, 9.81 * sign * np.eye(3)[axis])


def soft_fingertip_tracking() -> Iterator[Row]:
    """Track with soft fingertips and four joints per finger, and report infeasible travel before the motion"""
    for name, grasp_object, points in _find_grasps():
        if name != "allegro_right" or not isinstance(points, Grasp):
            continue
        soft = [replace(each, model="soft", torsional_friction=0.005) for each in points.contacts.contacts]
        grasp = replace(points, contacts=ContactSet.stack(soft))
        for limit in travel_limits(grasp, TRAVEL):
            along = ", ".join(f"{x + 0.0:.0f}" for x in limit.direction)
            label = f"{name}, soft, {grasp_object.name}, {1e3 * limit.distance:.0f} mm and back along ({along})"
            if limit.distance == 0.0:
                yield Row(label, "rejected in advance", limit.reason, True)
                continue
            there = limit.distance * limit.direction
            metrics = simulation.compute_metrics(
                run(grasp, 1.0, lambda start, d=there: simulation.linear_reference(start, d, 1.0))
            )
            angle = np.degrees(metrics.orientation_error_peak)
            measured = f"{1e3 * metrics.position_error_rms:.4f} mm, orientation error {angle:.3f}°"
            measured += f"; longer travel rejected: {limit.reason}" if limit.reason else ""
            yield Row(
                f"{label}: position error, RMS",
                f"≤ {MAX_ERROR} mm",
                measured,
                1e3 * metrics.position_error_rms <= MAX_ERROR and metrics.lost_contact_steps == metrics.slip_steps == 0,
            )


PARTS = (static_holding, sinusoid_tracking, uncontrollable_directions, all_gravity_directions, soft_fingertip_tracking)


def _along(axis: int) -> Array:
    """Return an acceleration of 1 m/s² along an axis of H, (6,)."""
    return np.eye(6)[axis]


@cache
def _find_grasps() -> tuple[tuple[str, GraspObject, Grasp | str], ...]:
    """Return each hand with each object, and the grasp with the palm up, or the reason why none was found."""
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
    """Return the limits in pairs of opposite directions, each line once."""
    pairs: list[tuple[TravelLimit, TravelLimit]] = []
    for limit in limits:
        if any(abs(limit.direction @ there.direction) > 0.999 for there, _ in pairs):
            continue
        back = [other for other in limits if limit.direction @ other.direction < -0.999]
        pairs.append((limit, back[0]))
    return pairs


def _static_row(label: str, grasp: Grasp, duration: float, gravity_H: Array) -> Row:
    """Return the row on holding at rest: no lost contact, no slip, position error below 1 mm and 1°."""
    try:
        metrics = simulation.compute_metrics(run(grasp, duration, gravity_H=gravity_H))
    except GraspForceError as error:
        return Row(label, "held", str(error), False)
    measured = f"{1e6 * metrics.position_error_peak:.2f} µm, {np.degrees(metrics.orientation_error_peak):.4f}°, "
    measured += f"{100 * metrics.max_torque_fraction:.0f} % of the torque limit"
    measured += f", {metrics.slip_steps} slip steps" if metrics.slip_steps else ""
    is_met = (
        metrics.lost_contact_steps == metrics.slip_steps == 0
        and metrics.position_error_peak < 1e-3
        and metrics.orientation_error_peak < np.radians(1.0)
    )
    return Row(label, "held", measured, is_met)
