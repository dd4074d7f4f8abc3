"""Quality and payload of a grasp: all measures in one record."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from graspforce.analysis.contact_errors import ContactErrors, payload_contact_errors, tolerated_contact_errors
from graspforce.analysis.contact_regions import ContactRegions, contact_regions, has_movable_contacts
from graspforce.analysis.ellipsoids import Ellipsoid, FingerEllipsoids, finger_ellipsoids, object_ellipsoid, wrench_ellipsoid
from graspforce.analysis.largest_wrench import LargestWrench, largest_wrench
from graspforce.analysis.wrench_set import VolumeBounds, limited_wrench_ball, wrench_volume
from graspforce.contact.closure import is_force_closed
from graspforce.contact.contact import ContactModel, ContactSet
from graspforce.contact.inscribed_ball import InscribedBall
from graspforce.contact.matrices import grasp_matrix_rank
from graspforce.contact.quality import wrench_ball
from graspforce.core import arrays
from graspforce.core.json_text import JsonRecord
from graspforce.core.text_table import Table
from graspforce.force.problem import ForceProblem
from graspforce.geometry.shape import Shape

SCHEMA = "graspforce/quality/1"
_DIRECTIONS = 8  # of the regions of contacts

_ANSWERS = {True: "yes", False: "no", None: "–"}

Measure = TypeVar("Measure")


@dataclass(frozen=True, eq=False, slots=True)
class Quality:
    """Measures of a grasp. Moments are about the contacts' centroid and divided by ``length``.

    Closure and the measures from ``epsilon_sum`` on are None if they were not computed by the deadline.

    Args:
        length: the characteristic length L that converts moments to forces, m: the root mean square distance of the contacts
            from their centroid.
        rank: rank of the grasp matrix, 6 if the contacts transmit all wrenches.
        force_closed: the contacts resist every wrench by their friction cones; motors and limits are not considered.
        form_closed: the contacts resist every wrench without friction.
        wrench: wrenches of contact forces of norm 1 N: its smallest semi-axis is σ_min, their ratio the isotropy.
        fingers: ellipsoids of the hand at each contact; empty without a hand.
        object_motion: twists of the object for joint rates of norm 1; None without a hand.
        payload: the largest wrench along a direction, in addition to the wrench of the problem; None if infeasible.
        epsilon_sum: ball of wrenches with Σ f_n ≤ 1 N (L1), N; its radius is ε of Ferrari and Canny (1992).
        epsilon_each: ball of wrenches with f_n ≤ 1 N at each contact (L∞), N.
        epsilon_limits: ball of wrenches about zero within the limits of normal forces and motors, N; None if no limit bounds
            the wrenches.
        disturbance: likewise about the wrench of the problem: the largest disturbance in any direction.
        volume: bounds on the volume of the wrenches with Σ f_n ≤ 1 N, N⁶; closer for at most 50 contacts.
        contact_errors: errors of contact places and normals up to which force closure is guaranteed.
        payload_errors: errors of each contact up to which the wrench of the problem is held; None if not asked for.
        closure_regions: how far each contact may move along the surface before closure is lost; None without a shape.
        payload_regions: likewise before the wrench of the problem cannot be held; None also if a hand has a
            frictionless contact.
    """

    length: float
    rank: int
    force_closed: bool | None
    form_closed: bool | None
    wrench: Ellipsoid
    fingers: tuple[FingerEllipsoids, ...]
    object_motion: Ellipsoid | None
    payload: LargestWrench | None
    epsilon_sum: InscribedBall | None
    epsilon_each: InscribedBall | None
    epsilon_limits: InscribedBall | None
    disturbance: InscribedBall | None
    volume: VolumeBounds | None
    contact_errors: ContactErrors | None
    payload_errors: ContactErrors | None = None
    closure_regions: ContactRegions | None = None
    payload_regions: ContactRegions | None = None

    def __str__(self) -> str:
        return str(Table(("measure", "value", "unit"), tuple(self._rows()), "Grasp quality"))

    def _repr_html_(self) -> str:
        return Table(("measure", "value", "unit"), tuple(self._rows()), "Grasp quality").to_html()

    def _rows(self) -> list[tuple[str, str, str]]:
        """Return the rows of the table."""
        amount = "infeasible" if self.payload is None else f"{self.payload.amount:.4g}"
        balls = (
            ("ε, sum of normal forces 1 N", self.epsilon_sum),
            ("ε, each normal force 1 N", self.epsilon_each),
            ("ε within all limits", self.epsilon_limits),
            ("disturbance in any direction", self.disturbance),
        )
        rows = [
            ("force closure", _ANSWERS[self.force_closed], ""),
            ("form closure (no friction)", _ANSWERS[self.form_closed], ""),
            ("characteristic length", f"{self.length:.4g}", "m"),
            ("smallest singular value of G", f"{self.wrench.sizes[-1]:.4g}", "N/N"),
            ("isotropy of G", f"{self.wrench.isotropy:.4g}", ""),
            ("payload along the direction", amount, "directions"),
        ]
        rows += [(name, "–" if ball is None else _bounds(ball.radius, ball.upper), "N") for name, ball in balls]
        if self.volume is not None:
            rows.append(("volume of wrenches", _bounds(self.volume.lower, self.volume.upper), "N⁶"))
        for kept, errors in (("closure", self.contact_errors), ("payload", self.payload_errors)):
            if errors is not None:
                rows.append((f"position error that {kept} survives", f"{1e3 * errors.position.min():.3g}", "mm"))
                rows.append((f"normal error that {kept} survives", f"{np.degrees(errors.normal.min()):.3g}", "°"))
        for regions in (self.closure_regions, self.payload_regions):
            if regions is not None and regions.regions:
                least = 1e3 * min(region.radius for region in regions.regions)
                rows.append((f"shift along the surface that {regions.kept} survives", f"{least:.3g}", "mm"))
        return rows

    def to_dict(self) -> JsonRecord:
        """Return the record of `SCHEMA`."""
        return {
            "schema": SCHEMA,
            "length": self.length,
            "rank": self.rank,
            "force_closed": self.force_closed,
            "form_closed": self.form_closed,
            "wrench_ellipsoid": self.wrench.to_dict(),
            "smallest_singular_value": float(self.wrench.sizes[-1]),
            "isotropy": self.wrench.isotropy,
            "epsilon_sum": _ball_record(self.epsilon_sum),
            "epsilon_each": _ball_record(self.epsilon_each),
            "epsilon_limits": _ball_record(self.epsilon_limits),
            "disturbance": _ball_record(self.disturbance),
            "volume": None if self.volume is None else dataclasses.asdict(self.volume),
            "contact_errors": None if self.contact_errors is None else self.contact_errors.to_dict(),
            "payload_errors": None if self.payload_errors is None else self.payload_errors.to_dict(),
            "closure_regions": None if self.closure_regions is None else self.closure_regions.to_dict(),
            "payload_regions": None if self.payload_regions is None else self.payload_regions.to_dict(),
            "payload": None if self.payload is None else self.payload.to_dict(),
            "fingers": [finger.to_dict() for finger in self.fingers],
            "object_motion": None if self.object_motion is None else self.object_motion.to_dict(),
        }


def quality(
    problem: ForceProblem,
    direction: npt.ArrayLike | None = None,
    *,
    seconds: float | None = None,
    payload_errors: bool = False,
    shape: Shape | None = None,
) -> Quality:
    """Return the quality and payload of the grasp of a force problem.

    Args:
        problem: the contacts, motors, limits and wrench; its objective is not used.
        direction: (6,) direction of the payload about O, in O, N and N·m; by default that of the problem's wrench, or a
            force of 1 N along z if that is zero.
        seconds: time after which no further measure is computed, s; by default all are.
        payload_errors: also compute the errors of contacts that the payload survives, which takes some tenths of a second.
        shape: the object's surface in O, to compute regions of contacts on it, which takes about a second.

    Raises:
        InvalidInput: a direction of zero, an array of another shape, numbers that are not finite, negative seconds, or as
            `contact_regions`.
    """
    limit = np.inf if seconds is None else arrays.check_number(seconds, "seconds", minimum=0.0)
    deadline = time.perf_counter() + limit
    contacts = problem.contacts
    if direction is None:
        direction = problem.w if problem.w.any() else np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    payload = largest_wrench(problem, direction)

    def before_deadline(measure: Callable[[], Measure]) -> Measure | None:
        return measure() if time.perf_counter() < deadline else None

    epsilon = before_deadline(lambda: wrench_ball(contacts))
    return Quality(
        length=problem.length,
        rank=grasp_matrix_rank(contacts),
        force_closed=before_deadline(lambda: is_force_closed(contacts)),
        form_closed=before_deadline(lambda: is_force_closed(_without_friction(contacts))),
        wrench=wrench_ellipsoid(contacts),
        fingers=finger_ellipsoids(problem),
        object_motion=object_ellipsoid(problem),
        payload=payload,
        epsilon_sum=epsilon,
        epsilon_each=before_deadline(lambda: wrench_ball(contacts, limit="each")),
        epsilon_limits=before_deadline(lambda: limited_wrench_ball(problem, np.zeros(6), deadline=deadline)),
        disturbance=before_deadline(lambda: limited_wrench_ball(problem, deadline=deadline)),
        volume=before_deadline(lambda: wrench_volume(contacts)),
        contact_errors=None if epsilon is None else tolerated_contact_errors(contacts, epsilon.radius),
        payload_errors=before_deadline(lambda: payload_contact_errors(problem)) if payload_errors else None,
        closure_regions=_regions(problem, shape, "closure", deadline),
        payload_regions=_regions(problem, shape, "payload", deadline),
    )


def _regions(problem: ForceProblem, shape: Shape | None, kept: str, deadline: float) -> ContactRegions | None:
    """Return the regions of the contacts; None without a shape, and for the payload if a contact's Jacobian is not known."""
    if shape is None or (kept == "payload" and not has_movable_contacts(problem)):
        return None
    return contact_regions(problem, shape, kept, directions=_DIRECTIONS, deadline=deadline)


def _without_friction(contacts: ContactSet) -> ContactSet:
    """Return the contacts as frictionless ones."""
    zero = arrays.freeze(np.zeros(len(contacts)))
    models = (ContactModel.FRICTIONLESS,) * len(contacts)
    return ContactSet(contacts.p_OC, contacts.R_OC, models, zero, zero, contacts.min_normal, contacts.max_normal)


def _ball_record(ball: InscribedBall | None) -> JsonRecord | None:
    """Return the record of a ball: bounds on its radius, and the weakest direction."""
    return None if ball is None else {"lower": ball.radius, "upper": ball.upper, "weakest": ball.direction.tolist()}


def _bounds(lower: float, upper: float) -> str:
    """Return one number, or an interval if the bounds differ in the first four digits."""
    low, high = f"{lower:.4g}", f"{upper:.4g}"
    return low if low == high else f"{low} to {high}"
