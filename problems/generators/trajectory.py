"""Sequences of problems along a motion, one for each instant, for warm-started solvers.

``trajectory/carry-3-017`` is the 18th instant of the third sequence. In a "carry", four fingers carry a box out and back
(`graspforce.problems.carry`). In a "turn", the hand rotates the object once, with fixed contacts.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graspforce.core.arrays import Array
from graspforce.problems.carry import sinusoidal_carry
from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.grasp_classes import contact_places
from graspforce.problems.generators.ist import GRAVITY
from graspforce.problems.generators.records import problem_record, rounded_contacts, rounded_hand
from graspforce.problems.objects import GraspObject, ist_objects

_STEPS = 41
_CARRIES = (  # period in s, travel along y and z in m, mass in kg, μ
    (1.0, 0.012, 0.012, 0.15, 0.6),
    (0.5, 0.012, 0.0, 0.10, 0.6),
    (0.5, 0.0, 0.012, 0.20, 0.5),
    (2.0, 0.010, 0.010, 0.30, 0.8),
    (0.3, 0.006, 0.006, 0.15, 0.4),
    (1.0, -0.012, 0.006, 0.05, 0.3),
)
_TURNING_GRASPS = (  # object and pose, grasp class
    ("medium green ball", "", "tripod"),
    ("big red cylinder", "side", "tripod"),
    ("small red cylinder", "side", "writing-tripod"),
    ("small red cylinder", "top", "tripod"),
    ("medium orange box", "short side", "parallel-extension"),
    ("small purple cube", "", "palmar-pinch"),
)


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    for number, (period, travel_y, travel_z, mass, mu) in enumerate(_CARRIES, start=1):
        steps = sinusoidal_carry(steps=_STEPS, period=period, travel_y=travel_y, travel_z=travel_z, mass=mass, friction=mu)
        source = f"Four fingers carry a box of {mass:g} kg out and back in {period:g} s; μ = {mu:g}."
        for i, step in enumerate(steps):
            assert step.problem.actuation is not None  # every carry has an actuation
            hand, records = rounded_hand(step.problem.actuation), rounded_contacts(step.problem.contacts)
            yield problem_record(
                f"trajectory/carry-{number}-{i:03}", source, records, step.problem.w, hand=hand, objective="torque"
            )
    known = {(grasp_object.name, grasp_object.pose): grasp_object for grasp_object in ist_objects()}
    for number, (name, pose, grasp_class) in enumerate(_TURNING_GRASPS, start=1):
        grasp_object = known[name, pose]
        records = [place.record for place in contact_places(grasp_object, grasp_class) or ()]
        source = f"{grasp_object.source}: {grasp_object.title}, {grasp_object.mass:.3g} kg, turned once about "
        source += f"a horizontal axis in a {grasp_class} grasp."
        for i, w in enumerate(_turning_loads(grasp_object)):
            yield problem_record(f"trajectory/turn-{number}-{i:03}", source, records, w, objective="force")


def _turning_loads(grasp_object: GraspObject) -> Iterator[Array]:
    """Yield the load while the object turns once about a tilted axis in O, at constant rate, without inertial forces."""
    start, beside = np.array([0.0, 0.6, -0.8]), np.array([0.8, 0.48, 0.36])
    for angle in np.linspace(0.0, 2 * np.pi, _STEPS):
        down = np.cos(angle) * start + np.sin(angle) * beside
        yield np.concatenate([-grasp_object.mass * GRAVITY * down, np.zeros(3)])
