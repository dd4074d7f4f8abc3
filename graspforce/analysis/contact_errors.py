"""Errors of contact places and normals that force closure survives: independent contact regions.

The wrenches of contacts with Σ f_n ≤ 1 N contain a ball of radius ε. An error of the contacts moves each of these wrenches by
at most some e, and with it the support function of their hull. So the moved hull contains a ball of radius ε − e: the grasp
stays closed if e < ε, whatever the direction of the errors, and for all contacts at once. Source: Roa and Suárez (2009).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.matrices import characteristic_length
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.json_text import JsonRecord


@dataclass(frozen=True, eq=False, slots=True)
class ContactErrors:
    """Guaranteed bounds: force closure survives errors of all contacts at once up to either column, in every direction.

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
