"""The IST objects held still in the eight grasp classes, gravity along each axis in turn, without and with a hand's motors.

With a hand, the object is placed so that the named fingertips reach its contacts: seeded postures are tried, the object is
fitted to the fingertips, and inverse kinematics closes the rest. Whether links touch each other is not looked at. The hand
"anthropomorphic15" is left out: its fingers move in planes, which such a search does not meet.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from graspforce.arrays import Array
from graspforce.body import Body
from graspforce.contact import ContactSet
from graspforce.errors import InvalidInput
from graspforce.hand import Hand
from graspforce.hold import Hold
from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.grasp_classes import GRASP_CLASSES, Place, places
from graspforce.problems.generators.statement import contact_set, short_hand, stated
from graspforce.problems.objects import GraspObject, ist_objects

GRAVITY = 9.81  # m/s²
DIRECTIONS = {
    f"{sign}{axis}": s * np.eye(3)[i] for i, axis in enumerate("xyz") for sign, s in (("plus-", 1.0), ("minus-", -1.0))
}
_HANDS = {  # which of a hand's fingers plays which part
    "four_finger": {"thumb": "finger_1", "first": "finger_3", "middle": "finger_4", "ring": "finger_2"},
    "dlr_hit2": {name: name for name in ("thumb", "middle", "ring", "little")} | {"first": "index"},
    "allegro_right": {"thumb": "thumb", "first": "index", "middle": "middle", "ring": "ring"},
}
_SEED = 7
_TRIES = 40  # postures for each hand
_FITS = 0.02  # m: how far fingertips may be from a fitted object for inverse kinematics to be worth its while


def cases() -> Iterator[Record]:
    """The collection."""
    hands = [(Hand.load(name), parts) for name, parts in _HANDS.items()]
    turn = 0
    for number, one in enumerate(ist_objects()):
        for kind, grasp_class in enumerate(GRASP_CLASSES):
            touching = places(one, grasp_class)
            if touching is None:
                continue
            name = f"{one.title}-{grasp_class}".replace(", ", "-").replace(" ", "-")
            records = [place.record for place in touching]
            grasp = grasp_class.replace("-", " ")
            source = f"{one.source}: {one.title} of {one.material}, {one.mass:.3g} kg, {grasp} grasp."
            for direction, axis in DIRECTIONS.items():
                w = _weight(one, axis)
                yield stated(f"ist/{name}-{direction}", source, records, w, objective="force")
            rng = np.random.default_rng([_SEED, number, kind])
            for tried in range(len(hands)):  # the hands take turns; where one cannot reach, the next is asked
                hand, parts = hands[(turn + tried) % len(hands)]
                held = hold(hand, parts, one, touching, rng)
                if held is not None:
                    yield from _with_motors(name, source, one, records, held)
                    break
            turn += 1


def _weight(one: GraspObject, down: Array) -> Array:
    """(6,) what bears the object where gravity pulls along ``down``, N and N·m."""
    force = -one.mass * GRAVITY * down  # N
    return np.concatenate([force, np.cross(one.com, force)]) + 0.0


def _with_motors(name: str, source: str, one: GraspObject, records: list[Record], held: Hold) -> Iterator[Record]:
    hand = held.hand
    for direction, axis in DIRECTIONS.items():
        gravity_H = GRAVITY * held.R_HO @ axis  # m/s²
        motors = hand.actuation(held.q, held.fingers, held.contacts, held.p_HO, held.R_HO, gravity_H=gravity_H)
        yield stated(
            f"ist/{name}-{direction}-{hand.name.replace('_', '-')}",
            f"{source} Held by {hand.name} within its motor limits.",
            records,
            _weight(one, axis),
            hand=short_hand(motors),
            objective="torque",
        )


def hold(
    hand: Hand, parts: dict[str, str], one: GraspObject, touching: Sequence[Place], rng: np.random.Generator
) -> Hold | None:
    """A posture in which the hand's fingers touch the object at the places, or None where none is found.

    Args:
        hand: the hand.
        parts: which of its fingers plays which part.
        one: the object.
        touching: the places and their parts.
        rng: where the tried postures come from.
    """
    if any(place.finger not in parts for place in touching):
        return None
    names, contacts = [parts[place.finger] for place in touching], contact_set([place.record for place in touching])
    radii = np.array([hand.finger(name).tip_radius or 0.0 for name in names])
    middles = contacts.p_OC - radii[:, None] * contacts.R_OC[:, :, 2]  # m, of the fingertips, in O
    for _ in range(_TRIES):
        q = hand.q_lower + (hand.q_upper - hand.q_lower) * rng.uniform(0.1, 0.9, hand.n)
        tips = np.array([hand.tip_pose(q, name)[0] for name in names])
        R_HO = _fitted(middles, tips, rng)
        p_HO = tips.mean(axis=0) - R_HO @ middles.mean(axis=0)
        if np.linalg.norm(p_HO + middles @ R_HO.T - tips, axis=1).max() > _FITS:
            continue
        posture = _reached(hand, names, contacts, p_HO, R_HO, q)
        if posture is not None:
            body = Body(one.mass, one.inertia, one.com, one.shape)
            return Hold(hand, body, tuple(names), contacts, posture, p_HO, R_HO)
    return None


def _reached(hand: Hand, names: list[str], contacts: ContactSet, p_HO: Array, R_HO: Array, q: Array) -> Array | None:
    try:
        return hand.grasp_posture(names, contacts, p_HO, R_HO, q)
    except InvalidInput:
        return None


def _fitted(points: Array, tips: Array, rng: np.random.Generator) -> Array:
    """The rotation that brings points nearest to the fingertips (Kabsch 1976); free turns that two points leave are drawn."""
    a, b = points - points.mean(axis=0), tips - tips.mean(axis=0)
    loose = 1e-9 * rng.normal(size=(3, 3))  # decides what the points do not
    U, _, Vt = np.linalg.svd(b.T @ a + loose * np.linalg.norm(a) * np.linalg.norm(b))
    turned = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(U @ Vt)))])
    return np.asarray(U @ turned @ Vt)
