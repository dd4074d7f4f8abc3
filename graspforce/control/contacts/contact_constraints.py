"""Kinematic constraints of the contacts: which relative velocities between fingers and object stay zero.

Friction constrains the velocity of a contact point along t₁ and t₂, the normal force the velocity along n. A soft contact
transmits a moment about n while the finger does not spin: n·(ω_F − ω_O) = 0. Its spin is a fourth row of A q̈ = B a + β
(`graspforce.contact.kinematics`).

A finger with three joints cannot follow a spin. Its soft contact then constrains the object until torsional friction gives way.
`graspforce.control.contacts.mobility` finds such constraints in the left null space of A, as for every finger with too few
joints.

Fingers with four joints can follow spins, but not near all postures. Their spin rows are damped there: the pads twist or slide
a little about their normals instead. Afterwards they turn back, so that the fingers return to their posture
(`graspforce.control.contacts.pad_spin`). With `ControlSettings.spin_compliance`, the object yields there instead, and the pads
stay where they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactSet
from graspforce.contact.kinematics import RollingContacts
from graspforce.core.arrays import Array

SPIN_DAMPING = 0.014  # m/rad: λ₀ of the spin rows
SPIN_ARM = 0.03  # m: converts a spin rate to the speed at this distance from n, the radius of a small object


@dataclass(frozen=True, eq=False, slots=True)
class ContactConstraints:
    """Constrained relative velocities of N contacts, r rows.

    Attributes:
        point_rows: (3 N,) mask of the constrained components (t₁, t₂, n) of the point velocities; None if all are.
        spin_contacts: indices of the contacts whose spin is constrained; None if there are none.
        contact_index: (r,) contact of each row, spins last.
        spin_damping: λ₀, damping of the spin rows, m/rad; see `graspforce.control.contacts.mobility`.
        spin_compliance: ℓ₀ of an object that yields instead, m/rad; 0 for one that does not.
    """

    point_rows: npt.NDArray[np.bool_] | None
    spin_contacts: npt.NDArray[np.intp] | None
    contact_index: npt.NDArray[np.intp]
    spin_damping: float = 0.0
    spin_compliance: float = 0.0

    @classmethod
    def from_contacts(cls, contacts: ContactSet) -> ContactConstraints:
        """Return the constraints of contacts.

        A contact with friction constrains all three components, a frictionless one the normal component only. Torsional
        friction constrains the spin as well.

        Args:
            contacts: contacts with their models and friction.
        """
        point_rows = np.array([[mu > 0.0, mu > 0.0, True] for mu in contacts.mu]).ravel()
        spin_contacts = np.flatnonzero(contacts.gamma)
        contact_index = np.concatenate([np.flatnonzero(point_rows) // 3, spin_contacts])
        return cls(None if point_rows.all() else point_rows, spin_contacts if len(spin_contacts) else None, contact_index)

    def without(self, contacts: npt.NDArray[np.bool_]) -> ContactConstraints:
        """Return the constraints of the other contacts; those of contacts that bear nothing are left out.

        Args:
            contacts: (N,) mask of the contacts to leave out.
        """
        point_rows = np.repeat(~contacts, 3)
        if self.point_rows is not None:
            point_rows &= self.point_rows
        spins = None if self.spin_contacts is None else self.spin_contacts[~contacts[self.spin_contacts]]
        index = self.contact_index[~contacts[self.contact_index]]
        return replace(
            self, point_rows=point_rows, spin_contacts=spins if spins is not None and len(spins) else None, contact_index=index
        )

    @property
    def spin_count(self) -> int:
        """Number of spin rows."""
        return 0 if self.spin_contacts is None else len(self.spin_contacts)

    @property
    def padded_rows(self) -> npt.NDArray[np.intp]:
        """(r,) position of each row among the padded rows 4 i + (t₁, t₂, n, spin) of contact i."""
        points = np.arange(3 * (self.contact_index.max() + 1)) if self.point_rows is None else np.flatnonzero(self.point_rows)
        spins = self.contact_index[len(self.contact_index) - self.spin_count :]
        return np.concatenate([points // 3 * 4 + points % 3, 4 * spins + 3])

    @property
    def row_units(self) -> Array:
        """(r,) contact force or moment per constraint force of each row: 1, and 30 mm for spins."""
        return np.repeat([1.0, SPIN_ARM], [len(self.contact_index) - self.spin_count, self.spin_count])

    @property
    def is_tracking_spin(self) -> bool:
        """Whether the memory holds the spins of the pads, which are taken back."""
        return self.spin_damping > 0.0 or self.spin_compliance > 0.0

    @property
    def damping(self) -> Array:
        """(r,) damping of each row, m/rad."""
        return np.repeat([0.0, self.spin_damping], [len(self.contact_index) - self.spin_count, self.spin_count])

    def is_spin_row(self, row: int) -> bool:
        """Return whether a row constrains a spin.

        Args:
            row: index of the row, from 0 to r − 1.
        """
        return row >= len(self.contact_index) - self.spin_count

    def constraint_rows(self, rolling: RollingContacts, spin_acceleration: Array | None = None) -> tuple[Array, Array, Array]:
        """Return A (r, n), B (r, 6) and beta (r,) of the constraints A q̈ = B a + beta.

        Spin rows come last and are scaled to speeds at 30 mm from n, so that all rows have the unit m/s².

        Args:
            rolling: the contacts at one instant.
            spin_acceleration: (N,) commanded accelerations of the fingers' spins, rad/s². Default: zeros.
        """
        A, B, beta = rolling.A, rolling.B, rolling.beta
        if self.point_rows is not None:
            A, B, beta = A[self.point_rows], B[self.point_rows], beta[self.point_rows]
        spin = rolling.spin
        if self.spin_contacts is not None and spin is not None:
            A = np.concatenate([A, SPIN_ARM * spin.A[self.spin_contacts]])
            B = np.concatenate([B, SPIN_ARM * spin.B[self.spin_contacts]])
            spin_beta = spin.beta if spin_acceleration is None else spin.beta + spin_acceleration
            beta = np.concatenate([beta, SPIN_ARM * spin_beta[self.spin_contacts]])
        return A, B, beta

    def constraint_forces(self, padded: Array) -> Array:
        """Return the forces that do work with the rows, (r,), N; a moment counts as a force at 30 mm from n.

        Args:
            padded: (N, 4) contact forces (f_t1, f_t2, f_n, m_n) in the contact frames, N and N·m.
        """
        f = padded[:, :3].ravel()
        if self.point_rows is not None:
            f = f[self.point_rows]
        return f if self.spin_contacts is None else np.concatenate([f, padded[self.spin_contacts, 3] / SPIN_ARM])
