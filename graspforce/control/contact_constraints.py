"""What contacts tie: friction a point's velocity along t₁ and t₂, pressing that along n, torsional friction the finger's spin.

A soft contact transmits a moment about n as long as the finger does not spin there, n·(ω_F − ω_O) = 0, so its spin is a fourth
row of A q̈ = B a + β (`rolling`). A finger of three joints cannot follow a spin. Until torsional friction gives way its contact
then ties the object, which `mobility` finds from A's left null space as it does for any finger that is short of joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.kinematics import RollingContacts
from graspforce.core.arrays import Array

_SPIN_ARM = 0.03  # m: spin counts beside velocities as the speed that it makes this far from n, a small object's radius


@dataclass(frozen=True, eq=False, slots=True)
class ContactConstraints:
    """Which of N contacts' relative velocities are kept at zero.

    Attributes:
        rows: (3 N,) which components of the points' velocities; None for all.
        spins: the contacts whose fingers may not spin; None for none.
        contact_index: (r,) the contact of each row that is kept, spins last.
    """

    point_rows: np.ndarray[Any, np.dtype[np.bool_]] | None
    spin_contacts: np.ndarray[Any, np.dtype[np.intp]] | None
    contact_index: np.ndarray[Any, np.dtype[np.intp]]

    @classmethod
    def from_contacts(cls, contacts: ContactSet) -> ContactConstraints:
        """All three components with friction, the normal one without; the spin with torsional friction."""
        point_rows = np.array([[mu > 0.0, mu > 0.0, True] for mu in contacts.mu]).ravel()
        spin_contacts = np.flatnonzero(contacts.gamma)
        contact = np.concatenate([np.flatnonzero(point_rows) // 3, spin_contacts])
        return cls(None if point_rows.all() else point_rows, spin_contacts if len(spin_contacts) else None, contact)

    @property
    def padded_rows(self) -> np.ndarray[Any, np.dtype[np.intp]]:
        """(r,) where each row that is kept stands among the padded ones, 4 i + (t₁, t₂, n, spin)."""
        spin_count = 0 if self.spin_contacts is None else len(self.spin_contacts)
        points = np.arange(3 * (self.contact_index.max() + 1)) if self.point_rows is None else np.flatnonzero(self.point_rows)
        return np.concatenate(
            [points // 3 * 4 + points % 3, 4 * self.contact_index[len(self.contact_index) - spin_count :] + 3]
        )

    def is_spin_row(self, row: int) -> bool:
        """Whether a row of A is a spin."""
        return self.spin_contacts is not None and row >= len(self.contact_index) - len(self.spin_contacts)

    def constraint_rows(self, rolling: RollingContacts) -> tuple[Array, Array, Array]:
        """A, B and beta of what is kept, as in `RollingContacts`; spins last, as speeds 30 mm off n."""
        A, B, beta = rolling.A, rolling.B, rolling.beta
        if self.point_rows is not None:
            A, B, beta = A[self.point_rows], B[self.point_rows], beta[self.point_rows]
        spin = rolling.spin
        if self.spin_contacts is not None and spin is not None:
            A = np.concatenate([A, _SPIN_ARM * spin.A[self.spin_contacts]])
            B = np.concatenate([B, _SPIN_ARM * spin.B[self.spin_contacts]])
            beta = np.concatenate([beta, _SPIN_ARM * spin.beta[self.spin_contacts]])
        return A, B, beta

    def constraint_forces(self, padded: Array) -> Array:
        """The forces that do work with those components, of padded ones (N, 4): N, moments as forces 30 mm off n."""
        f = padded[:, :3].ravel()
        if self.point_rows is not None:
            f = f[self.point_rows]
        return f if self.spin_contacts is None else np.concatenate([f, padded[self.spin_contacts, 3] / _SPIN_ARM])
