"""The eight grasp classes of 004, section 3.2, as contact places on the objects of its Table 1.

The places are ours, drawn for each class from its name and pictures: the thumb on one side of the object, the fingers on the
other, closing along the object's ``across``; d = ``approach`` is where the hand comes, r = d × across runs along the row of
fingers. Fingertips pinch with soft contacts, pads have a longer lever against twisting than tips.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.arrays import Array
from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.statement import short_contact
from graspforce.problems.objects import GraspObject
from graspforce.shapes import Box, Cylinder, Sphere

GRASP_CLASSES = (
    "tip-pinch",
    "palmar-pinch",
    "tripod",
    "lateral-tripod",
    "writing-tripod",
    "lateral",
    "adduction-grip",
    "parallel-extension",
)
_TIP, _PAD, _SIDE = 0.002, 0.004, 0.006  # m, γ: how long a lever the contact of tip, pad and finger's side has
_MOST, _GENTLE = 20.0, 5.0  # N, the largest normal force: of a finger, and of fingers that close sideways
_SMALL, _NARROW = 0.030, 0.040  # m: the widest that is held between two fingers, and between thumb and finger's side
_APART = 0.010  # m from the middle at most, of two fingers side by side
_ROW = 0.035  # m from the middle at most, of four fingers in a row


@dataclass(frozen=True, eq=False, slots=True)
class Place:
    """Which finger ("thumb", "first", "middle", "ring", "little") touches where, and the contact's record."""

    finger: str
    record: Record


def places(one: GraspObject, grasp_class: str) -> tuple[Place, ...] | None:
    """Where the fingers touch; None where the class does not apply: 004 used writing grasps for cylinders alone, and
    closed the fingers sideways only on small objects."""
    a, d = one.across, one.approach
    r = np.cross(d, a)
    if grasp_class == "tip-pinch":
        return _touch(one, {"thumb": -a, "first": a}, gamma=_TIP)
    if grasp_class == "palmar-pinch":
        apart = min(_APART, 0.5 * _half(one, r))  # m
        return _touch(one, {"thumb": -a, "first": a, "middle": a}, {"first": apart * r, "middle": -apart * r}, gamma=_PAD)
    if grasp_class == "tripod":
        if isinstance(one.shape, Box):
            wide = min(2 * _APART, 0.6 * _half(one, r))  # m
            return _touch(one, {"thumb": -a, "first": a, "middle": a}, {"first": wide * r, "middle": -wide * r})
        b = _beside(one)
        return _touch(one, {"thumb": -a, "first": 0.5 * a + 0.75**0.5 * b, "middle": 0.5 * a - 0.75**0.5 * b})
    if grasp_class == "lateral-tripod":
        return _touch(one, {"thumb": -a, "first": a, "middle": _beside(one)})
    if grasp_class == "writing-tripod" and isinstance(one.shape, Cylinder):
        b, axis = _beside(one), np.array([0.0, 0.0, 1.0])
        towards = {"thumb": -0.8 * a + 0.6 * b, "first": 0.8 * a + 0.6 * b, "middle": -b}
        end = -0.5 * _half(one, axis) * axis  # m
        return _touch(one, towards, {"thumb": end, "first": 1.1 * end, "middle": 1.3 * end}, gamma=_TIP)
    if grasp_class == "lateral" and one.span <= _NARROW:
        return _touch(one, {"thumb": -a, "first": a}, gamma=_SIDE)
    if grasp_class == "adduction-grip" and one.span <= _SMALL:
        return _touch(one, {"first": -a, "middle": a}, gamma=_PAD, most=_GENTLE)
    if grasp_class == "parallel-extension" and not isinstance(one.shape, Sphere) and one.pose != "top":
        reach = min(_ROW, 0.8 * _half(one, r))  # m
        row = {"first": reach, "middle": reach / 3, "ring": -reach / 3, "little": -reach}
        return _touch(one, {"thumb": -a, **dict.fromkeys(row, a)}, {finger: along * r for finger, along in row.items()})
    return None


def _touch(
    one: GraspObject,
    towards: dict[str, Array],
    shifted: dict[str, Array] | None = None,
    *,
    gamma: float | None = None,
    most: float = _MOST,
) -> tuple[Place, ...]:
    """Contacts where rays from the middle leave the object, moved along it: soft ones where γ is given."""
    found = []
    for finger, direction in towards.items():
        along = (shifted or {}).get(finger, np.zeros(3))
        outside = 2.0 * one.span * direction if isinstance(one.shape, Sphere) else direction
        p = one.shape.nearest(outside + along)
        soft = {} if gamma is None else {"model": "soft", "torsional_friction": gamma}
        record = short_contact(p, one.shape.inward_normal(p), friction=one.friction, max_normal=most, **soft)
        found.append(Place(finger, record))
    return tuple(found)


def _beside(one: GraspObject) -> Array:
    """The unit axis across ``across`` on which the object's section is as round as along it: around a cylinder."""
    r = np.cross(one.approach, one.across)
    return one.approach if isinstance(one.shape, Cylinder) and one.pose == "side" else np.asarray(r)


def _half(one: GraspObject, axis: Array) -> float:
    """The object's half-extent along an axis, m."""
    return float(np.linalg.norm(one.shape.nearest(1e3 * axis)))
