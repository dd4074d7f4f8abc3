"""Regions of contacts on the object's surface: how far each contact may err before closure or the payload is lost.

A region is found by walking: from the place of a contact, straight lines in the tangent plane are continued along the surface,
and their ends are where the grasp loses its property for the first time. One contact moves, the others stay. Between two steps
of a line the property is not tested.

The contact frame turns with the normal, without spin. A fingertip keeps the Jacobian of its place in O: rows of forces turn
into the new frame, and the row of a soft contact's moment stays.
Contrast `contact_errors`, whose bounds are guaranteed for errors in every direction of space, but not the largest.
Sources: Nguyen (1988); Roa and Suárez (2009).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from graspforce.contact.closure import is_force_closed
from graspforce.contact.contact import ContactModel
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.lazy import plot_with
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.solver import solve
from graspforce.geometry.shape import Shape

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KEPT = ("closure", "payload")
_STEPS = 32  # of a line
_BISECTIONS = 6  # of its last step
_OFF_SURFACE = 1e-3  # characteristic lengths: contacts farther from the surface do not touch it

Place = tuple[Array, Array]  # position (3,) and frame (3, 3) in O


@dataclass(frozen=True, eq=False, slots=True)
class ContactRegion:
    """The region of one contact, a star around its place.

    Args:
        contact: index of the contact.
        kept: "closure": the contacts resist every wrench by friction; "payload": forces supply the wrench of the problem.
        points: (D, 3) ends of the lines in O, m; the directions turn from t₁ to t₂ of the contact frame in equal steps.
        distances: (D,) their lengths along the surface, m; 0 without the property at the place itself.
        ends: (D) "lost" where the property ends, "edge" where the surface has an edge, "limit" at the largest distance.
    """

    contact: int
    kept: str
    points: Array
    distances: Array
    ends: tuple[str, ...]

    @property
    def radius(self) -> float:
        """The shortest distance, m."""
        return float(self.distances.min())

    def to_dict(self) -> JsonRecord:
        """Return the record."""
        numbers = {"points": self.points.tolist(), "distances": self.distances.tolist()}
        return {"contact": self.contact, "kept": self.kept, **numbers, "ends": list(self.ends)}


@dataclass(frozen=True, eq=False, slots=True)
class ContactRegions:
    """The regions of all contacts that were found by the deadline, for one property.

    Args:
        kept: "closure" or "payload".
        regions: one for each contact, in order.
    """

    kept: str
    regions: tuple[ContactRegion, ...]

    def plot(self) -> Figure:
        """Return a map of each region in the tangent plane of its contact, in mm along the surface."""
        figure: Figure = plot_with("plot_contact_regions", self)
        return figure

    def to_dict(self) -> list[JsonRecord]:
        """Return the records of the regions."""
        return [region.to_dict() for region in self.regions]


def contact_regions(
    problem: ForceProblem,
    shape: Shape,
    kept: str = "payload",
    *,
    directions: int = 16,
    largest: float | None = None,
    deadline: float = np.inf,
) -> ContactRegions:
    """Return how far each contact may move along the object's surface, one at a time, before the grasp loses a property.

    Args:
        problem: the contacts, motors, limits and wrench; its uncertainty is not used.
        shape: the object's surface in O.
        kept: "closure" or "payload", as in `ContactRegion`.
        directions: number of directions, 4 to 360.
        largest: largest distance that is tried, m; by default π times the characteristic length of the contacts.
        deadline: time of the clock `time.perf_counter`, s, after which no further region is returned.

    Raises:
        InvalidInput: a contact that does not touch the surface, a value that is not allowed, or for the payload a frictionless
            contact of a hand, whose Jacobian is known along its normal only.
    """
    fields.check_choice(kept, "kept", KEPT)
    fields.check_integer(directions, "directions", minimum=4, maximum=360)
    most = np.pi * problem.length if largest is None else arrays.check_number(largest, "largest", above=0.0)
    if kept == "payload" and not has_movable_contacts(problem):
        raise InvalidInput("kept", kept, "closure: the Jacobian of a frictionless contact is known along its normal only")
    places = _places_on_surface(problem, shape)
    holds = _is_closed if kept == "closure" else _holds_payload
    regions: list[ContactRegion] = []
    for i, place in enumerate(places):
        walk = _Walk(shape, most, partial(holds, problem, i), deadline)
        region = _region(i, kept, place, walk, directions)
        if region is None:
            break
        regions.append(region)
    return ContactRegions(kept, tuple(regions))


def has_movable_contacts(problem: ForceProblem) -> bool:
    """Return whether the Jacobian of each contact is known in all directions: not of a frictionless contact of a hand.

    Args:
        problem: the force problem.
    """
    return problem.actuation is None or ContactModel.FRICTIONLESS not in problem.contacts.models


def _places_on_surface(problem: ForceProblem, shape: Shape) -> list[Place]:
    """Return position and frame of each contact; raise an error for a contact that does not touch the surface."""
    contacts = problem.contacts
    off = np.linalg.norm(shape.project_to_surface(contacts.p_OC) - contacts.p_OC, axis=1)
    for i in np.flatnonzero(off > _OFF_SURFACE * problem.length):
        raise InvalidInput(f"contacts[{i}].position", contacts.p_OC[i], f"on the surface, which is {1e3 * off[i]:.3g} mm away")
    return list(zip(shape.project_to_surface(contacts.p_OC), contacts.R_OC, strict=True))


@dataclass(frozen=True, slots=True)
class _Walk:
    """What a walk along the surface needs.

    Args:
        shape: the surface.
        most: largest distance, m.
        holds: whether the grasp has the property with the contact at a place.
        deadline: time of the clock `time.perf_counter`, s.
    """

    shape: Shape
    most: float
    holds: Callable[[Place], bool]
    deadline: float


def _region(contact: int, kept: str, place: Place, walk: _Walk, directions: int) -> ContactRegion | None:
    """Return the region of one contact; None after the deadline."""
    ends, points, distances = [], [], []
    for k in range(directions):
        if time.perf_counter() >= walk.deadline:
            return None
        angle = 2.0 * np.pi * k / directions
        heading = place[1][:, 0] * np.cos(angle) + place[1][:, 1] * np.sin(angle)
        point, distance, end = _line(place, heading, walk)
        points.append(point)
        distances.append(distance)
        ends.append(end)
    return ContactRegion(contact, kept, arrays.freeze(points), arrays.freeze(distances), tuple(ends))


def _line(place: Place, heading: Array, walk: _Walk) -> tuple[Array, float, str]:
    """Return the last point of a line with the property, its distance along the surface, and why the line ends."""
    step, distance = walk.most / _STEPS, 0.0
    if not walk.holds(place):
        return place[0], 0.0, "lost"
    while distance < (1.0 - 1e-9) * walk.most:
        length = min(step, walk.most - distance)
        following = _advance(place, heading, walk.shape, length)
        if following is None or not walk.holds(following[0]):
            best, further = _last_good(place, heading, walk, length)
            return best, distance + further, "edge" if following is None else "lost"
        distance += float(np.linalg.norm(following[0][0] - place[0]))
        place, heading = following
    return place[0], distance, "limit"


def _last_good(place: Place, heading: Array, walk: _Walk, length: float) -> tuple[Array, float]:
    """Return the last point with the property within a step at whose end it is lost, and its distance, m."""
    low, high, best = 0.0, length, place[0]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        there = _advance(place, heading, walk.shape, middle)
        if there is not None and walk.holds(there[0]):
            low, best = middle, there[0][0]
        else:
            high = middle
    return best, float(np.linalg.norm(best - place[0]))


def _advance(place: Place, heading: Array, shape: Shape, length: float) -> tuple[Place, Array] | None:
    """Return place and heading after a step along the surface; None where the surface has no normal."""
    p, R = place
    there = shape.project_to_surface(p + length * heading)
    try:
        normal = shape.inward_normal(there)
    except InvalidInput:
        return None
    if float(normal @ R[:, 2]) <= 0.0:  # around an edge
        return None
    turn = _rotation_between(R[:, 2], normal)
    next_heading = turn @ heading
    return (there, turn @ R), next_heading / np.linalg.norm(next_heading)


def _rotation_between(a: Array, b: Array) -> Array:
    """Return the rotation without spin that turns the unit vector a to b, which is not −a."""
    axis = np.cross(a, b)
    K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + float(a @ b)))


def _moved(problem: ForceProblem, i: int, place: Place) -> ForceProblem:
    """Return the problem with contact i at another place; its Jacobian is turned into the new frame."""
    contacts, a = problem.contacts, problem.actuation
    p, R = contacts.p_OC.copy(), contacts.R_OC.copy()
    turn = place[1].T @ R[i]  # from the old to the new frame
    p[i], R[i] = place
    left, _, right = np.linalg.svd(R[i])  # removes the rounding of many steps
    R[i] = left @ right
    moved = problem.replace(p=p, R=R)
    if a is None:
        return moved
    rows = np.flatnonzero(contacts.columns // 4 == i)
    forces = rows[contacts.columns[rows] % 4 < 3]
    J = a.J.copy()
    J[forces] = turn @ a.J[forces]
    return ForceProblem(moved.contacts, problem.w, a.replace(J=J), problem.cone, problem.objective)


def _is_closed(problem: ForceProblem, i: int, place: Place) -> bool:
    """Return whether the contacts resist every wrench with contact i at another place."""
    return is_force_closed(_moved(problem, i, place).contacts)


def _holds_payload(problem: ForceProblem, i: int, place: Place) -> bool:
    """Return whether forces supply the wrench of the problem with contact i at another place."""
    moved = _moved(problem, i, place)
    return solve(ForceProblem(moved.contacts, moved.w, moved.actuation, moved.cone, Objective("force")), explain=False).found
