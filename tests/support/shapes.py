"""Shapes, and points on their surfaces, for tests."""

from __future__ import annotations

import numpy as np

from graspforce.geometry import Box, Cylinder, ImplicitSurface, Sphere, Superquadric

AXES = np.array([0.03, 0.05, 0.08])  # m


def ellipsoid_level(p):
    return float(np.sum((p / AXES) ** 2) - 1.0)


def dented_level(p):
    """Return φ of a sphere of 5 cm with smooth dents and bumps: neither convex nor symmetric."""
    x, y, z = p / 0.05
    return float(x * x + y * y + z * z - 1.0 + 0.3 * np.sin(2 * x) * y + 0.2 * z * x)


def dented_gradient(p):
    x, y, z = p / 0.05
    slope = [2 * x + 0.6 * np.cos(2 * x) * y + 0.2 * z, 2 * y + 0.3 * np.sin(2 * x), 2 * z + 0.2 * x]
    return np.array(slope) / 0.05


SOLIDS = {
    "sphere": Sphere(0.07),
    "cylinder": Cylinder(0.03, 0.11),
    "box": Box([0.04, 0.06, 0.1]),
    "ellipsoid": Superquadric(AXES, [1.0, 1.0]),
    "boxy": Superquadric(AXES, [0.3, 0.4]),
    "pillow": Superquadric(AXES, [1.6, 0.5]),
    "cushion": Superquadric(AXES, [0.6, 1.7]),
    "octahedron": Superquadric(AXES, [2.0, 2.0]),
    "double cone": Superquadric(AXES, [2.0, 1.0]),
    "drum": Superquadric(AXES, [0.1, 1.0]),
}
SURFACES = {
    "implicit": ImplicitSurface(ellipsoid_level, lambda p: 2.0 * p / AXES**2, 0.08),
    "dented": ImplicitSurface(dented_level, dented_gradient, 0.05),
}
SHAPES = SOLIDS | SURFACES


def radial_distances(shape, directions):
    """Return distances from the centre to the surface along unit directions, by bisection; all shapes are star-shaped."""
    near, far = np.zeros(len(directions)), np.full(len(directions), 0.3)
    for _ in range(60):
        middle = 0.5 * (near + far)
        inside = shape.phi(middle[:, None] * directions) < 0.0
        near, far = np.where(inside, middle, near), np.where(inside, far, middle)
    return near


def directions(seed, count):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1)[:, None]


def surface_points(shape, seed, count):
    """Return surface points at least 0.1 mm away from all edges and tips."""
    d = directions(seed, count)
    points = radial_distances(shape, d)[:, None] * d
    kinked = isinstance(shape, Superquadric) and (shape.exponents == 2.0).any()
    if kinked:
        return points[np.abs(points).min(axis=1) > 1e-4]
    if isinstance(shape, Box):
        return points[np.sort(shape.edges / 2 - np.abs(points), axis=1)[:, 1] > 1e-4]
    if isinstance(shape, Cylinder):
        rim = np.maximum(shape.radius - np.hypot(*points[:, :2].T), shape.height / 2 - np.abs(points[:, 2]))
        return points[rim > 1e-4]
    return points
