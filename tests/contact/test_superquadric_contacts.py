"""Closest points of superquadrics in C: those of the reference, from outside, from inside, near the surface and on the axes."""

from __future__ import annotations

import numpy as np
import pytest
from support.shapes import SOLIDS

from graspforce.contact.compiled_kinematics import rolling_contacts
from graspforce.contact.contact import ContactModel, ContactSet
from graspforce.contact.motion import BodyMotion, TipMotion
from graspforce.core.arrays import Array
from graspforce.geometry import Superquadric

pytest.importorskip("graspforce.core._native", reason="the compiled module was not built: no C compiler at installation")

SHAPES = {name: shape for name, shape in SOLIDS.items() if isinstance(shape, Superquadric)}
SHAPES["long"] = Superquadric([0.3, 0.02, 0.05], [1.9, 0.8])
SHAPES["thin"] = Superquadric([0.03, 0.02, 0.05], [0.05, 1.95])


def compiled_closest_points(shape: Superquadric, p: Array) -> Array:
    """Return the closest points of the surface that the C code computes, (N, 3), m: those of fingertips at rest at p."""
    count = len(p)
    R, ones, zeros = np.tile(np.eye(3), (count, 1, 1)), np.ones(count), np.zeros(count)
    contacts = ContactSet(np.zeros((count, 3)), R, (ContactModel.POINT,) * count, ones, zeros, zeros, 20.0 * ones)
    tips, at_rest = TipMotion(p, R, np.zeros((count, 6, 3))), BodyMotion(np.zeros(3), np.eye(3))
    return rolling_contacts(tips, 0.01 * ones, at_rest, shape, contacts, R).p_OC


@pytest.mark.parametrize("name", SHAPES)
def test_closest_points_equal_the_reference(name: str) -> None:
    """Both stop where the distance no longer changes in double precision: its minimum agrees to rounding.

    The place is less certain than the distance. Of equally close points, either may be found.
    """
    shape, rng = SHAPES[name], np.random.default_rng(3)
    size, axes = float(shape.axes.max()), np.diag(shape.axes)
    fingertips = shape.closest_points(rng.normal(size=(40, 3)) * size)
    places = [rng.normal(size=(60, 3)) * size, 1.2 * fingertips, 1.003 * fingertips, 0.5 * rng.uniform(-1, 1, (15, 3)) @ axes]
    places += [1.5 * axes, -1.2 * axes, 0.3 * axes, np.zeros((1, 3))]
    p = np.vstack(places)
    found, expected = compiled_closest_points(shape, p), shape.closest_points(p)
    distances = (np.linalg.norm(points - p, axis=1) for points in (found, expected))
    np.testing.assert_allclose(*distances, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(shape.phi(found), 0.0, rtol=0.0, atol=1e-15)
    unique = slice(0, 140)  # those outside; inside, two points may be equally close
    outside = shape.phi(p[unique]) > 0.0
    np.testing.assert_allclose(found[unique][outside], expected[unique][outside], rtol=0.0, atol=1e-9 * size)
