"""Opposite points of a shape: pairs of surface points whose normals are nearly parallel to the line between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.geometry import Solid, TriangleMesh

_STEPS = 64  # of a ray through the shape
_BISECTIONS = 20  # of the interval in which a ray leaves the shape
_START = 1e-3  # of the longest ray, from the surface to the ray's first point
_LEAST_COS = 0.9  # of the angle between the ray and the outward normal where it leaves: 26°
_TINY = 1e-12
_HULL_DEPTH = 3e-4  # m: a point of a mesh deeper in the convex hull counts as not on the hull


@dataclass(frozen=True, eq=False, slots=True)
class OppositePoints:
    """K pairs of opposite points.

    Attributes:
        first: (K, 3) first points in O, m.
        normal: (K, 3) inward normals there, in O.
        width: (K,) distances of the second points from the first, along the normals, m.
    """

    first: Array
    normal: Array
    width: Array


def find_opposite_points(shape: Solid, rng: np.random.Generator, count: int) -> OppositePoints:
    """Return random pairs of opposite points.

    Args:
        shape: the surface.
        rng: random generator.
        count: number of first points that are tried.
    """
    size = shape._largest_half_extent
    along = rng.normal(size=(count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    points = shape.closest_points(shape.centre + size * rng.uniform(0.2, 1.5, (count, 1)) * along)
    gradient = shape._gradient(points)
    steepness = np.linalg.norm(gradient, axis=1)
    points, gradient = points[steepness > _TINY], gradient[steepness > _TINY]
    normal = -gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    width, is_opposite = ray_widths(shape, points, normal)
    kept = is_opposite & _on_hull(shape, points) & _on_hull(shape, points + width[:, None] * normal)
    return OppositePoints(points[kept], normal[kept], width[kept])


def ray_widths(shape: Solid, points: Array, directions: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return where rays into a shape leave it first, and whether the surface there is nearly perpendicular to the ray.

    Args:
        shape: the surface.
        points: (K, 3) points of the surface in O, m.
        directions: (K, 3) unit vectors into the shape, in O.

    Returns:
        (K,) lengths of the rays, m, and (K,) flags.
    """
    longest = 4.0 * shape._largest_half_extent
    lengths = longest * np.linspace(_START, 1.0, _STEPS)
    inside = (
        shape._phi((points[:, None] + lengths[:, None] * directions[:, None]).reshape(-1, 3)).reshape(len(points), -1) < 0.0
    )
    leaves = ~inside[:, 1:] & inside[:, :-1]
    k = leaves.argmax(axis=1)
    low, high = lengths[k], lengths[k + 1]
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2.0
        is_inside = shape._phi(points + middle[:, None] * directions) < 0.0
        low, high = np.where(is_inside, middle, low), np.where(is_inside, high, middle)
    gradient = shape._gradient(shape.closest_points(points + low[:, None] * directions))
    cosine = (gradient * directions).sum(axis=1) / np.maximum(np.linalg.norm(gradient, axis=1), _TINY)
    return low, leaves.any(axis=1) & inside[:, 0] & (cosine > _LEAST_COS)


def _on_hull(shape: Solid, points: Array) -> npt.NDArray[np.bool_]:
    """Return whether points (K, 3) of a mesh are on its convex hull; all points of other shapes are."""
    if not isinstance(shape, TriangleMesh):
        return np.ones(len(points), dtype=bool)
    from scipy.spatial import ConvexHull  # imported here, because it is slow to import

    planes = ConvexHull(shape.vertices).equations
    return np.asarray((points @ planes[:, :3].T + planes[:, 3]).max(axis=1, initial=-np.inf) > -_HULL_DEPTH)
