"""Errors of contact places and normals that force closure and payload survive: independent contact regions.

The wrenches of contacts with Σ f_n ≤ 1 N contain a ball of radius ε. An error of the contacts moves each of these wrenches by
at most some e, and with it the support function of their hull. So the moved hull contains a ball of radius ε − e: the grasp
stays closed if e < ε, whatever the direction of the errors, and for all contacts at once. Source: Roa and Suárez (2009).

The payload survives an error of one contact if one squeeze supplies the wrench of the problem within all limits for every error
up to that size (`graspforce.force.robust_set`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import characteristic_length
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.solver import solve
from graspforce.force.uncertainty import Uncertainty

_SMALLEST_SHARE = 1e-3  # of the largest error that is tried


@dataclass(frozen=True, eq=False, slots=True)
class ContactErrors:
    """Guaranteed bounds on errors in every direction: of all contacts at once for closure, of one contact for the payload.

    Args:
        position: (N,) radius of the region of each contact, m.
        normal: (N,) angle of rotation of each contact frame, rad; at most π.
    """

    position: Array
    normal: Array

    def to_dict(self) -> JsonRecord:
        """Return the record."""
        return {"position": self.position.tolist(), "normal": self.normal.tolist()}


def tolerated_contact_errors(contacts: ContactSet, epsilon: float) -> ContactErrors:
    """Return errors of contact places, or of contact frames, up to which force closure is guaranteed.

    A force with f_n = 1 N has at most √(1 + μ²) N. A displacement δ changes its moment by at most δ √(1 + μ²), and a
    rotation by θ changes the wrench by at most 2 sin(θ/2) (√(1 + μ²) √(1 + ‖p − c‖²/L²) + γ/L).

    Args:
        contacts: the contacts.
        epsilon: a lower bound on ε of `wrench_ball` with the limit "sum", N.

    Returns:
        The bounds; zeros if the grasp is not closed.
    """
    L = characteristic_length(contacts)
    force = np.hypot(1.0, contacts.mu)
    arm = np.linalg.norm(contacts.p_OC - contacts.centroid, axis=1) / L
    chord = epsilon / (force * np.hypot(1.0, arm) + contacts.gamma / L)
    return ContactErrors(arrays.freeze(epsilon * L / force), arrays.freeze(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))))


def payload_contact_errors(problem: ForceProblem, tolerance: float = 0.05) -> ContactErrors:
    """Return errors of each contact, one at a time, up to which one squeeze holds the wrench of a problem within all limits.

    The squeeze is planned for the error, and the reaction redistributes as in `Uncertainty`. A larger error may be tolerated:
    the search stops at the bounds of the robust problem, and a squeeze may also be planned for the true place.

    Args:
        problem: the force problem; its objective and uncertainty are not used.
        tolerance: relative accuracy of the search, in (0, 1).

    Returns:
        The bounds: zeros if the problem is infeasible, if the contacts do not transmit every wrench (positions), and at
        frictionless contacts (normals).

    Raises:
        InvalidInput: tolerance outside its range.
    """
    arrays.check_number(tolerance, "tolerance", above=0.0)
    if tolerance >= 1.0:
        raise InvalidInput("tolerance", tolerance, "less than 1")
    count, length = len(problem.contacts), problem.length
    angles = np.arctan(problem.contacts.mu).tolist()

    def places(errors: Array) -> Uncertainty:
        return Uncertainty(position_error=errors)

    def normals(errors: Array) -> Uncertainty:
        return Uncertainty(normal_error=errors)

    position = [_largest_error(problem, places, i, length, tolerance) for i in range(count)]
    normal = [_largest_error(problem, normals, i, angles[i], tolerance) for i in range(count)]
    return ContactErrors(arrays.freeze(position), arrays.freeze(normal))


def _largest_error(
    problem: ForceProblem, errors_of: Callable[[Array], Uncertainty], contact: int, most: float, tolerance: float
) -> float:
    """Return an error of one contact up to which a squeeze holds, at most `most`; 0 below 10⁻³ of it."""

    def holds(size: float) -> bool:
        errors = np.zeros(len(problem.contacts))
        errors[contact] = size
        p = problem
        try:
            plain = (p.contacts, p.w, p.actuation, p.cone, Objective("force"))
            return solve(ForceProblem(*plain, uncertainty=errors_of(errors))).found
        except InvalidInput:  # no reaction, or no friction left
            return False

    low, high = 0.0, most
    while high - low > tolerance * high:
        middle = 0.5 * (low + high) if low > 0.0 else 0.3 * high
        if middle < _SMALLEST_SHARE * most:
            return 0.0
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low
