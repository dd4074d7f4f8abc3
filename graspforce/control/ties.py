"""What contacts tie: friction a point's velocity along t₁ and t₂, pressing that along n, torsional friction the finger's spin.

A soft contact transmits a moment about n as long as the finger does not spin there, n·(ω_F − ω_O) = 0, so its spin is a fourth
row of A q̈ = B a + β (`rolling`). A finger of three joints cannot follow a spin. Until torsional friction gives way its contact
then ties the object, which `mobility` finds from A's left null space as it does for any finger that is short of joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from graspforce.arrays import Array
from graspforce.contact import ContactSet
from graspforce.control.rolling import RollingContacts

_SPIN_ARM = 0.03  # m: spin counts beside velocities as the speed that it makes this far from n, a small object's radius


@dataclass(frozen=True, eq=False, slots=True)
class Ties:
    """Which of N contacts' relative velocities are kept at zero.

    Attributes:
        rows: (3 N,) which components of the points' velocities; None for all.
        spins: the contacts whose fingers may not spin; None for none.
        contact: (r,) the contact of each row that is kept, spins last.
    """

    rows: np.ndarray[Any, np.dtype[np.bool_]] | None
    spins: np.ndarray[Any, np.dtype[np.intp]] | None
    contact: np.ndarray[Any, np.dtype[np.intp]]

    @classmethod
    def made_by(cls, contacts: ContactSet) -> Ties:
        """All three components with friction, the normal one without; the spin with torsional friction."""
        rows = np.array([[mu > 0.0, mu > 0.0, True] for mu in contacts.mu]).ravel()
        spins = np.flatnonzero(contacts.gamma)
        contact = np.concatenate([np.flatnonzero(rows) // 3, spins])
        return cls(None if rows.all() else rows, spins if len(spins) else None, contact)

    @property
    def padded(self) -> np.ndarray[Any, np.dtype[np.intp]]:
        """(r,) where each row that is kept stands among the padded ones, 4 i + (t₁, t₂, n, spin)."""
        spins = 0 if self.spins is None else len(self.spins)
        points = np.arange(3 * (self.contact.max() + 1)) if self.rows is None else np.flatnonzero(self.rows)
        return np.concatenate([points // 3 * 4 + points % 3, 4 * self.contact[len(self.contact) - spins :] + 3])

    def is_spin(self, row: int) -> bool:
        """Whether a row of A is a spin."""
        return self.spins is not None and row >= len(self.contact) - len(self.spins)

    def of(self, rolling: RollingContacts) -> tuple[Array, Array, Array]:
        """A, B and beta of what is kept, as in `RollingContacts`; spins last, as speeds 30 mm off n."""
        A, B, beta = rolling.A, rolling.B, rolling.beta
        if self.rows is not None:
            A, B, beta = A[self.rows], B[self.rows], beta[self.rows]
        spin = rolling.spin
        if self.spins is not None and spin is not None:
            A = np.concatenate([A, _SPIN_ARM * spin.A[self.spins]])
            B = np.concatenate([B, _SPIN_ARM * spin.B[self.spins]])
            beta = np.concatenate([beta, _SPIN_ARM * spin.beta[self.spins]])
        return A, B, beta

    def forces(self, padded: Array) -> Array:
        """The forces that do work with those components, of padded ones (N, 4): N, moments as forces 30 mm off n."""
        f = padded[:, :3].ravel()
        if self.rows is not None:
            f = f[self.rows]
        return f if self.spins is None else np.concatenate([f, padded[self.spins, 3] / _SPIN_ARM])
