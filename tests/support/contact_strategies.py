"""Random contacts, rotations and forces for tests."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from graspforce import Contact, ContactSet
from graspforce.core.arrays import Array

seeds = st.integers(0, 2**32 - 1)
coefficients = st.one_of(st.just(0.0), st.floats(1e-6, 1e-3), st.floats(0.05, 2.0))


def random_rotation(rng: np.random.Generator) -> Array:
    """Return a uniformly distributed rotation matrix."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def contacts_around_object(
    rng: np.random.Generator, count: int, models: tuple[str, ...] = ("point", "soft", "frictionless")
) -> ContactSet:
    """Return contacts around a rough object of about 5 cm radius, with normals about 10° off the direction to its centre."""
    contacts = []
    for _ in range(count):
        out = rng.normal(size=3)
        out /= np.linalg.norm(out)
        contacts.append(
            Contact(
                position=0.05 * out + 0.01 * rng.normal(size=3),
                normal=-out + 0.2 * rng.normal(size=3),
                friction=rng.uniform(0.1, 0.8),
                model=str(rng.choice(models)),
                torsional_friction=rng.uniform(0.002, 0.01),
            )
        )
    return ContactSet.stack(contacts)


def contact_ring(count: int, mu: float = 0.5, radius: float = 0.05, **more: object) -> ContactSet:
    """Return evenly spaced contacts around the equator whose normals point to the centre."""
    angles = 2.0 * np.pi * np.arange(count) / count
    out = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(count)])
    return ContactSet.stack([Contact(radius * x, -x, mu, **more) for x in out])


def transformed(contacts: ContactSet, R: Array, p: Array, scale: float = 1.0) -> ContactSet:
    """Return the contacts in another frame: turned by R, scaled in the unit of length, and shifted by p."""
    return ContactSet.stack(
        [
            Contact(
                position=scale * R @ c.position + p,
                normal=R @ c.normal,
                tangent=R @ c.tangent,
                friction=c.friction,
                model=c.model,
                torsional_friction=None if c.torsional_friction is None else scale * c.torsional_friction,
            )
            for c in contacts.contacts
        ]
    )
