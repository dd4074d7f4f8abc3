"""Random motions of fingertips, and contacts, for tests of rolling contact."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact.contact import ContactModel, ContactSet
from graspforce.contact.motion import TipMotion
from graspforce.core.arrays import Array
from graspforce.geometry import Box, Cylinder, Shape, Sphere

HALF_EDGES = np.array([0.025, 0.03, 0.02])  # m
SHAPES: dict[str, Shape | None] = {
    "sphere": Sphere(0.03),
    "cylinder": Cylinder(0.028, 0.07),
    "disc": Cylinder(0.035, 0.03),
    "box": Box(2.0 * HALF_EDGES),
    "none": None,
}


def random_rotations(rng: np.random.Generator, count: int) -> Array:
    """Return (count, 3, 3) rotation matrices."""
    return np.asarray(Rotation.random(count, random_state=rng).as_matrix())


def random_tip_motion(rng: np.random.Generator, p_HF: Array, n: int) -> TipMotion:
    """Return fingertips at given places with random rates: up to about 0.3 m/s and 3 rad/s."""
    rates = rng.normal(size=(len(p_HF), 6, n + 2)) * np.array([0.1, 0.1, 0.1, 1.0, 1.0, 1.0])[:, None]
    return TipMotion(p_HF, random_rotations(rng, len(p_HF)), rates)


def random_initial_contacts(rng: np.random.Generator, models: tuple[ContactModel, ...]) -> ContactSet:
    """Return contacts at random places; the fingertips need not be there."""
    count = len(models)
    p_OC, R_OC, ones = 0.03 * rng.normal(size=(count, 3)), random_rotations(rng, count), np.ones(count)
    return ContactSet(p_OC, R_OC, models, 0.5 * ones, 0.005 * ones, 0.0 * ones, 20.0 * ones)
