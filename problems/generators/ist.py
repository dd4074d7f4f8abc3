"""The IST objects at rest in eight grasp classes, with gravity along each axis, without and with a hand's torque limits.

With a hand, the object is placed so that the named fingertips reach its contacts. Seeded postures are tried, the object is
fitted to the fingertips, and inverse kinematics removes the remaining error. Collisions between links are ignored. The hand
"anthropomorphic15" is excluded: its fingers move in planes, and the search finds no posture for them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand
from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.grasp_classes import GRASP_CLASSES, ContactPlace, contact_places
from graspforce.problems.generators.records import contact_set, problem_record, rounded_hand
from graspforce.problems.objects import GraspObject, ist_objects

GRAVITY = 9.81  # m/s²
DIRECTIONS = {
    f"{sign}{axis}": s * np.eye(3)[i] for i, axis in enumerate("xyz") for sign, s in (("plus-", 1.0), ("minus-", -1.0))
}
_HANDS = {  # fingers of each hand, by their role
    "four_finger": {"thumb": "finger_1", "first": "finger_3", "middle": "finger_4", "ring": "finger_2"},
    "dlr_hit2": {name: name for name in ("thumb", "middle", "ring", "little")} | {"first": "index"},
    "allegro_right": {"thumb": "thumb", "first": "index", "middle": "middle", "ring": "ring"},
}
_SEED = 7
_MAX_TRIES = 40  # postures for each hand
_MAX_FIT_ERROR = 0.02  # m: largest distance from a fingertip to its fitted contact at which inverse kinematics is tried


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    hands = [(Hand.load(name), finger_roles) for name, finger_roles in _HANDS.items()]
    hand_turn = 0
    for number, grasp_object in enumerate(ist_objects()):
        for kind, grasp_class in enumerate(GRASP_CLASSES):
            places_touched = contact_places(grasp_object, grasp_class)
            if places_touched is None:
                continue
            name = f"{grasp_object.title}-{grasp_class}".replace(", ", "-").replace(" ", "-")
            records = [place.record for place in places_touched]
            grasp_name = grasp_class.replace("-", " ")
            source = f"{grasp_object.source}: {grasp_object.title} ({grasp_object.material}), "
            source += f"{grasp_object.mass:.3g} kg, {grasp_name} grasp."
            for direction, axis in DIRECTIONS.items():
                w = _weight(grasp_object, axis)
                yield problem_record(f"ist/{name}-{direction}", source, records, w, objective="force")
            rng = np.random.default_rng([_SEED, number, kind])
            for attempt in range(len(hands)):  # round-robin over the hands; if one cannot reach, try the next
                hand, finger_roles = hands[(hand_turn + attempt) % len(hands)]
                grasp = fit_grasp(hand, finger_roles, grasp_object, places_touched, rng)
                if grasp is not None:
                    yield from _with_motors(name, source, grasp_object, records, grasp)
                    break
            hand_turn += 1


def _weight(grasp_object: GraspObject, down: Array) -> Array:
    """Return the (6,) wrench that carries the object, with gravity along ``down``, N and N·m."""
    force = -grasp_object.mass * GRAVITY * down  # N
    return np.concatenate([force, np.cross(grasp_object.com, force)]) + 0.0


def _with_motors(name: str, source: str, grasp_object: GraspObject, records: list[Record], grasp: Grasp) -> Iterator[Record]:
    hand = grasp.hand
    for direction, axis in DIRECTIONS.items():
        gravity_H = GRAVITY * grasp.R_HO @ axis  # m/s²
        actuation = grasp.actuation(gravity_H)
        yield problem_record(
            f"ist/{name}-{direction}-{hand.name.replace('_', '-')}",
            f"{source} With the torque limits of the hand {hand.name}.",
            records,
            _weight(grasp_object, axis),
            hand=rounded_hand(actuation),
            objective="torque",
        )


def fit_grasp(
    hand: Hand,
    finger_roles: dict[str, str],
    grasp_object: GraspObject,
    places_touched: Sequence[ContactPlace],
    rng: np.random.Generator,
) -> Grasp | None:
    """Return a grasp in which the fingers touch the object at the contact places; None if the search finds none.

    Args:
        hand: the hand.
        finger_roles: finger of the hand for each role.
        grasp_object: the object.
        places_touched: the contact places and their roles.
        rng: random source of start postures.
    """
    if any(place.finger not in finger_roles for place in places_touched):
        return None
    names, contacts = (
        [finger_roles[place.finger] for place in places_touched],
        contact_set([place.record for place in places_touched]),
    )
    radii = np.array([hand.finger(name).tip_radius or 0.0 for name in names])
    tip_centres = contacts.p_OC - radii[:, None] * contacts.R_OC[:, :, 2]  # m, of the fingertips, in O
    for _ in range(_MAX_TRIES):
        q = hand.q_lower + (hand.q_upper - hand.q_lower) * rng.uniform(0.1, 0.9, hand.n)
        tips = np.array([hand.tip_pose(q, name)[0] for name in names])
        R_HO = _fit_rotation(tip_centres, tips, rng)
        p_HO = tips.mean(axis=0) - R_HO @ tip_centres.mean(axis=0)
        if np.linalg.norm(p_HO + tip_centres @ R_HO.T - tips, axis=1).max() > _MAX_FIT_ERROR:
            continue
        posture = _solve_posture(hand, names, contacts, p_HO, R_HO, q)
        if posture is not None:
            body = Body(grasp_object.mass, grasp_object.inertia, grasp_object.com, grasp_object.shape)
            return Grasp(hand, body, tuple(names), contacts, posture, p_HO, R_HO)
    return None


def _solve_posture(hand: Hand, names: list[str], contacts: ContactSet, p_HO: Array, R_HO: Array, q: Array) -> Array | None:
    try:
        return hand.grasp_posture(names, contacts, p_HO, R_HO, q)
    except InvalidInput:
        return None


def _fit_rotation(points: Array, tips: Array, rng: np.random.Generator) -> Array:
    """Return the rotation that brings points closest to the fingertips (Kabsch 1976), random if it is not unique."""
    a, b = points - points.mean(axis=0), tips - tips.mean(axis=0)
    tie_breaker = 1e-9 * rng.normal(size=(3, 3))  # selects the rotation if the points do not determine it
    U, _, Vt = np.linalg.svd(b.T @ a + tie_breaker * np.linalg.norm(a) * np.linalg.norm(b))
    signs = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(U @ Vt)))])
    return np.asarray(U @ signs @ Vt)
