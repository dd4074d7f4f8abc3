"""Contact places of eight grasp classes on the IST objects.

The classes are those of the HANDLE project, Parameterizing and creating new actions (undated), section 3.2. The contact places
are assumed, from the name and the pictures of each class. The thumb is on one side of the object and the fingers on the other;
they close along the object's ``closing_axis`` a. The hand approaches along d = ``approach``, and the row of fingers is along
r = d × a. Pinches use soft contacts. The torsional friction γ of a finger pad is larger than that of a fingertip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry import Box, Cylinder, Sphere
from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.records import rounded_contact
from graspforce.problems.objects import GraspObject

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
_TIP_GAMMA, _PAD_GAMMA, _SIDE_GAMMA = 0.002, 0.004, 0.006  # m: γ of the tip, the pad and the side of a finger
_MAX_NORMAL = 20.0  # N: largest normal force of a finger
_SIDE_MAX_NORMAL = 5.0  # N: the same for fingers that close sideways
_MAX_ADDUCTION_SPAN = 0.030  # m: largest width of an object between two fingers
_MAX_LATERAL_SPAN = 0.040  # m: largest width of an object between the thumb and the side of a finger
_MAX_PAIR_OFFSET = 0.010  # m: largest distance from the centre, of two fingers side by side
_MAX_ROW_OFFSET = 0.035  # m: largest distance from the centre, of four fingers in a row


@dataclass(frozen=True, eq=False, slots=True)
class ContactPlace:
    """A contact and its finger.

    Args:
        finger: "thumb", "first", "middle", "ring" or "little".
        record: record of the contact.
    """

    finger: str
    record: Record


def contact_places(grasp_object: GraspObject, grasp_class: str) -> tuple[ContactPlace, ...] | None:
    """Return the contact places of a grasp class on an object; None if the class does not apply to the object.

    The HANDLE project used writing grasps for cylinders only, and closed fingers sideways on small objects only.

    Args:
        grasp_object: the object.
        grasp_class: one of `GRASP_CLASSES`.
    """
    a, d = grasp_object.closing_axis, grasp_object.approach
    r = np.cross(d, a)
    if grasp_class == "tip-pinch":
        return _contacts_along(grasp_object, {"thumb": -a, "first": a}, gamma=_TIP_GAMMA)
    if grasp_class == "palmar-pinch":
        apart = min(_MAX_PAIR_OFFSET, 0.5 * _half_extent(grasp_object, r))  # m
        return _contacts_along(
            grasp_object, {"thumb": -a, "first": a, "middle": a}, {"first": apart * r, "middle": -apart * r}, gamma=_PAD_GAMMA
        )
    if grasp_class == "tripod":
        if isinstance(grasp_object.shape, Box):
            wide = min(2 * _MAX_PAIR_OFFSET, 0.6 * _half_extent(grasp_object, r))  # m
            return _contacts_along(
                grasp_object, {"thumb": -a, "first": a, "middle": a}, {"first": wide * r, "middle": -wide * r}
            )
        b = _perpendicular_axis(grasp_object)
        return _contacts_along(grasp_object, {"thumb": -a, "first": 0.5 * a + 0.75**0.5 * b, "middle": 0.5 * a - 0.75**0.5 * b})
    if grasp_class == "lateral-tripod":
        return _contacts_along(grasp_object, {"thumb": -a, "first": a, "middle": _perpendicular_axis(grasp_object)})
    if grasp_class == "writing-tripod" and isinstance(grasp_object.shape, Cylinder):
        b, axis = _perpendicular_axis(grasp_object), np.array([0.0, 0.0, 1.0])
        directions = {"thumb": -0.8 * a + 0.6 * b, "first": 0.8 * a + 0.6 * b, "middle": -b}
        end = -0.5 * _half_extent(grasp_object, axis) * axis  # m
        return _contacts_along(
            grasp_object, directions, {"thumb": end, "first": 1.1 * end, "middle": 1.3 * end}, gamma=_TIP_GAMMA
        )
    if grasp_class == "lateral" and grasp_object.span <= _MAX_LATERAL_SPAN:
        return _contacts_along(grasp_object, {"thumb": -a, "first": a}, gamma=_SIDE_GAMMA)
    if grasp_class == "adduction-grip" and grasp_object.span <= _MAX_ADDUCTION_SPAN:
        return _contacts_along(grasp_object, {"first": -a, "middle": a}, gamma=_PAD_GAMMA, max_normal_force=_SIDE_MAX_NORMAL)
    if grasp_class == "parallel-extension" and not isinstance(grasp_object.shape, Sphere) and grasp_object.pose != "top":
        half_row = min(_MAX_ROW_OFFSET, 0.8 * _half_extent(grasp_object, r))  # m
        row = {"first": half_row, "middle": half_row / 3, "ring": -half_row / 3, "little": -half_row}
        return _contacts_along(
            grasp_object, {"thumb": -a, **dict.fromkeys(row, a)}, {finger: along * r for finger, along in row.items()}
        )
    return None


def _contacts_along(
    grasp_object: GraspObject,
    directions: dict[str, Array],
    offsets: dict[str, Array] | None = None,
    *,
    gamma: float | None = None,
    max_normal_force: float = _MAX_NORMAL,
) -> tuple[ContactPlace, ...]:
    """Return contacts where rays from the centre, shifted by ``offsets``, leave the object; soft contacts if γ is given."""
    found = []
    for finger, direction in directions.items():
        along = (offsets or {}).get(finger, np.zeros(3))
        outside = 2.0 * grasp_object.span * direction if isinstance(grasp_object.shape, Sphere) else direction
        p = grasp_object.shape.project_to_surface(outside + along)
        soft = {} if gamma is None else {"model": "soft", "torsional_friction": gamma}
        record = rounded_contact(
            p, grasp_object.shape.inward_normal(p), friction=grasp_object.friction, max_normal=max_normal_force, **soft
        )
        found.append(ContactPlace(finger, record))
    return tuple(found)


def _perpendicular_axis(grasp_object: GraspObject) -> Array:
    """Return the unit axis of the object perpendicular to ``closing_axis`` in its roundest section."""
    r = np.cross(grasp_object.approach, grasp_object.closing_axis)
    return grasp_object.approach if isinstance(grasp_object.shape, Cylinder) and grasp_object.pose == "side" else np.asarray(r)


def _half_extent(grasp_object: GraspObject, axis: Array) -> float:
    """Return the object's half-extent along an axis, m."""
    return float(np.linalg.norm(grasp_object.shape.project_to_surface(1e3 * axis)))
