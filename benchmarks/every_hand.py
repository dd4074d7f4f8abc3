"""Every shipped hand in the loop: what it holds, and how it follows along the directions that its fingers can move."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from benchmarks.loop import EARTH, PALM_UP, Row, run
from graspforce import ContactSet, GraspForceError, Hand, simulation
from graspforce.arrays import Array
from graspforce.body import Body, BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController
from graspforce.hands.description import shipped_hands
from graspforce.hold import Hold
from graspforce.hold_search import Way, find_hold, ways_of
from graspforce.problems.objects import GraspObject, ist_objects
from graspforce.shapes import Sphere

THINGS = ("big green ball", "large blue box, long side", "small red cylinder, side")  # of Table 1 of 004
TRAVEL = 0.005  # m, either way: 10 mm peak to peak
BAR = 0.05  # mm RMS at 1 Hz, as is asked of Allegro


def gravity_of(hand: str) -> Array:
    """Palm up."""
    return PALM_UP if hand.startswith("allegro") else EARTH


def holds() -> Iterator[Row]:
    """Every shipped hand holds a ball, a box and a cylinder for 10 s"""
    for name, thing, hold in _found():
        what = f"{name} holds the {thing.name} ({1e3 * thing.mass:.0f} g, μ = {thing.friction}) for 10 s"
        if isinstance(hold, Hold):
            yield _held(what, hold, 10.0, gravity_of(name))
        else:
            yield Row(what, "held", hold, False)


def follows() -> Iterator[Row]:
    """Every shipped hand follows a sinusoid of 1 Hz along each way that its fingers can go"""
    for name, thing, hold in _found():
        if not isinstance(hold, Hold):
            continue
        for there, back in _pairs(ways_of(hold, TRAVEL)):
            amplitude = min(there.reached, back.reached)
            along = ", ".join(f"{x:.2f}" for x in there.direction)
            what = f"{name}, {thing.name}, ±{1e3 * amplitude:.0f} mm at 1 Hz along ({along}): RMS"
            stop = there.stop or back.stop
            if amplitude == 0.0:
                yield Row(what, f"≤ {BAR} mm", stop, False)
                continue
            sine = amplitude * there.direction
            recording = run(hold, 2.0, lambda start, d=sine: simulation.sine(start, d, 1.0), gravity_H=gravity_of(name))
            got = simulation.figures(recording.since(1.0))
            measured = f"{1e3 * got.tracking_rms:.4f} mm, forces {100 * got.force_error:.2f} % off the plan"
            measured += f"; 5 mm is too far: {stop}" if stop else ""
            met = 1e3 * got.tracking_rms <= BAR and got.lost == got.slid == 0 and amplitude >= TRAVEL
            yield Row(what, f"≤ {BAR} mm", measured, met)


def sideways() -> Iterator[Row]:
    """What planar fingers cannot do is said, with the force that the structure bears"""
    for name, thing, hold in _found():
        if not isinstance(hold, Hold):
            continue
        settings = ControlSettings(gravity_H=gravity_of(name))
        at_rest = BodyMotion(hold.p_HO, hold.R_HO)
        state = GraspState(hold.q, np.zeros(hold.hand.n), at_rest)
        said = [ObjectController(hold, settings).step(state, at_rest.accelerated(_along(axis))) for axis in range(3)]
        blocked = [f"{'xyz'[axis]} {np.linalg.norm(said[axis].acceleration[:3] - _along(axis)[:3]):.0%}" for axis in range(3)]
        if not len(said[0].uncontrollable):
            continue
        bears = np.linalg.norm(said[0].borne[:3])
        measured = f"{len(said[0].uncontrollable)} twists cannot be made; refused of 1 m/s² along {', '.join(blocked)}; "
        measured += f"the structure bears {bears:.2f} N"
        yield Row(f"{name}, {thing.name}: uncontrollable directions are reported", "reported", measured, True)


def any_way_up() -> Iterator[Row]:
    """The hand of 003 holds a ball whichever way its palm looks"""
    hold = find_hold(Hand.load("anthropomorphic15"), Body.solid(Sphere(0.03), 0.05), friction=0.7)
    for axis in range(3):
        for sign in (1.0, -1.0):
            what = f"anthropomorphic15 holds 50 g for 3 s, gravity along {'+' if sign > 0 else '-'}{'xyz'[axis]}"
            yield _held(what, hold, 3.0, 9.81 * sign * np.eye(3)[axis])


def soft_fingertips() -> Iterator[Row]:
    """Fingertips that bear a moment about the normal, four joints behind each: what they follow, and what is refused before"""
    for name, thing, points in _found():
        if name != "allegro_right" or not isinstance(points, Hold):
            continue
        soft = [replace(each, model="soft", torsional_friction=0.005) for each in points.contacts.contacts]
        hold = replace(points, contacts=ContactSet.stack(soft))
        for way in ways_of(hold, TRAVEL):
            along = ", ".join(f"{x + 0.0:.0f}" for x in way.direction)
            what = f"{name}, soft, {thing.name}, {1e3 * way.reached:.0f} mm and back along ({along}): RMS"
            if way.reached == 0.0:
                yield Row(what.removesuffix(": RMS"), "refused before", way.stop, True)
                continue
            there = way.reached * way.direction
            got = simulation.figures(run(hold, 1.0, lambda start, d=there: simulation.reach(start, d, 1.0)))
            measured = f"{1e3 * got.tracking_rms:.4f} mm, turned {np.degrees(got.turn_peak):.3f}°"
            measured += f"; further is refused: {way.stop}" if way.stop else ""
            yield Row(what, f"≤ {BAR} mm", measured, 1e3 * got.tracking_rms <= BAR and got.lost == got.slid == 0)


PARTS = (holds, follows, sideways, any_way_up, soft_fingertips)


def _along(axis: int) -> Array:
    """1 m/s² along an axis of H."""
    return np.eye(6)[axis]


@cache
def _found() -> tuple[tuple[str, GraspObject, Hold | str], ...]:
    """Each hand with each thing, palm up, and the hold, or why there is none."""
    things = {thing.title: thing for thing in ist_objects()}
    found: list[tuple[str, GraspObject, Hold | str]] = []
    for name in shipped_hands():
        for title in THINGS:
            thing = things[title]
            body = Body(thing.mass, thing.inertia, thing.com, thing.shape)
            hold: Hold | str
            try:
                hold = find_hold(Hand.load(name), body, friction=thing.friction, gravity_H=gravity_of(name))
            except GraspForceError as error:
                hold = str(error)
            found.append((name, thing, hold))
    return tuple(found)


def _pairs(ways: tuple[Way, ...]) -> list[tuple[Way, Way]]:
    """Ways to and fro along one line, each line once."""
    pairs: list[tuple[Way, Way]] = []
    for way in ways:
        if any(abs(way.direction @ there.direction) > 0.999 for there, _ in pairs):
            continue
        back = [other for other in ways if way.direction @ other.direction < -0.999]
        pairs.append((way, back[0]))
    return pairs


def _held(what: str, hold: Hold, duration: float, gravity_H: Array) -> Row:
    """Still for a while: every finger touches, every force stays in its cone, and the object where it was."""
    try:
        got = simulation.figures(run(hold, duration, gravity_H=gravity_H))
    except GraspForceError as error:
        return Row(what, "held", str(error), False)
    measured = f"{1e6 * got.tracking_peak:.2f} µm, {np.degrees(got.turn_peak):.4f}°, motors {100 * got.torque_share:.0f} %"
    measured += f", {got.slid} steps at the edge of friction" if got.slid else ""
    met = got.lost == got.slid == 0 and got.tracking_peak < 1e-3 and got.turn_peak < np.radians(1.0)
    return Row(what, "held", measured, met)
