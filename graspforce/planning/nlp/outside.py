"""A smooth measure of whether a point keeps its distance from a primitive.

The distance from a sphere is kept as a squared distance. A box or cylinder is enlarged by the distance and kept out by

    log Σ exp(κ eᵢ)/κ ≥ 0,    eᵢ the distance of the point beyond each pair of faces

This is smooth where the largest of the eᵢ is not. It equals that one next to a face, and exceeds it only near edges, where
the enlarged box extends beyond the true clearance of a round tip.
"""

from __future__ import annotations

import casadi as ca

from graspforce.geometry import Box, Solid, Sphere

_SHARPNESS = 5.0  # κ times the distance
_ABS_SMOOTHING = 1e-4  # ε of |x| ≈ √(x² + ε²) − ε, relative to the distance


def outside_level(kind: type[Solid], x: ca.SX, sizes: ca.SX, least: ca.SX) -> ca.SX:
    """Return a level that is ≥ 1 where a point keeps its distance from a primitive.

    Args:
        kind: Sphere, Cylinder or Box.
        x: (3,) the point in the primitive's axes, from its centre, m.
        sizes: radius of a sphere, radius and half height of a cylinder, or half edges of a box, m.
        least: the distance, m, > 0.
    """
    if kind is Sphere:
        return ca.dot(x, x) / (sizes + least) ** 2
    epsilon = _ABS_SMOOTHING * least
    distances = [x[0], x[1], x[2]] if kind is Box else [ca.sqrt(x[0] ** 2 + x[1] ** 2 + epsilon**2), x[2]]
    excess = ca.vertcat(*(ca.sqrt(each**2 + epsilon**2) - epsilon for each in distances)) - sizes - least
    return 1.0 + ca.logsumexp(_SHARPNESS * excess / least) / _SHARPNESS
