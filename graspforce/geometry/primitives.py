"""Sphere, cylinder and box, with closed forms. φ is the signed distance from the surface."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.records import set_fields
from graspforce.geometry.shape import SURFACE_TOLERANCE, Solid
from graspforce.geometry.vectors import row_norms, unit_vectors


@dataclass(frozen=True, slots=True)
class Sphere(Solid):
    """Sphere: φ = ‖x‖ − r.

    Args:
        radius: r, m, > 0.

    Raises:
        InvalidInput: the radius is not a positive number.
    """

    radius: float
    _places_without_normal: ClassVar[str] = "at the centre"

    def __post_init__(self) -> None:
        set_fields(self, radius=arrays.check_number(self.radius, "radius", above=0.0))

    @property
    def _largest_half_extent(self) -> float:
        return self.radius

    @property
    def volume(self) -> float:
        return 4.0 / 3.0 * math.pi * self.radius**3

    @property
    def _mean_products(self) -> Array:
        return self.radius**2 / 5.0 * np.eye(3)

    def _phi(self, p: Array) -> Array:
        return row_norms(p) - self.radius

    def _gradient(self, p: Array) -> Array:
        return unit_vectors(p)

    def _hessian(self, p: Array) -> Array:
        n = unit_vectors(p)
        return np.asarray((np.eye(3) - n[:, :, None] * n[:, None, :]) / row_norms(p)[:, None, None])

    def closest_points(self, p: Array) -> Array:
        return self.radius * unit_vectors(p, fallback=(1.0, 0.0, 0.0))

    @property
    def primitive_parameters(self) -> tuple[str, float, float, float]:
        return "sphere", self.radius, 0.0, 0.0


@dataclass(frozen=True, slots=True)
class Cylinder(Solid):
    """Circular cylinder about the z axis, from z = −height/2 to height/2.

    Args:
        radius: r, m, > 0.
        height: m, > 0.

    Raises:
        InvalidInput: a size is not a positive number.
    """

    radius: float
    height: float
    _places_without_normal: ClassVar[str] = "on the rim"

    def __post_init__(self) -> None:
        radius = arrays.check_number(self.radius, "radius", above=0.0)
        set_fields(self, radius=radius, height=arrays.check_number(self.height, "height", above=0.0))

    @property
    def _largest_half_extent(self) -> float:
        return max(self.radius, self.height / 2.0)

    @property
    def volume(self) -> float:
        return math.pi * self.radius**2 * self.height

    @property
    def _mean_products(self) -> Array:
        return np.diag([self.radius**2 / 4.0, self.radius**2 / 4.0, self.height**2 / 12.0])

    def _face_excess(self, p: Array) -> Array:
        """Return the distances (N, 2) beyond the side and beyond the nearer end, m; in a half-plane a cylinder is a box."""
        return np.column_stack([np.hypot(p[:, 0], p[:, 1]) - self.radius, np.abs(p[:, 2]) - self.height / 2.0])

    def _phi(self, p: Array) -> Array:
        return _box_distance(self._face_excess(p))

    def _radial_directions(self, p: Array) -> Array:
        """Return the unit vectors (N, 3) away from the axis."""
        return unit_vectors(p * [1.0, 1.0, 0.0], fallback=(1.0, 0.0, 0.0))

    def _gradient(self, p: Array) -> Array:
        face = _box_face(self._face_excess(p), SURFACE_TOLERANCE * self._largest_half_extent)
        end = np.where(p[:, 2:] < 0.0, -1.0, 1.0)
        return np.asarray(face[:, :1] * self._radial_directions(p) + face[:, 1:] * end * [0.0, 0.0, 1.0])

    def _hessian(self, p: Array) -> Array:
        side = _box_face(self._face_excess(p), SURFACE_TOLERANCE * self._largest_half_extent)[:, 0]
        around = np.cross([0.0, 0.0, 1.0], self._radial_directions(p))
        distance = np.hypot(p[:, 0], p[:, 1])  # m, from the axis
        curvature = np.divide(side, distance, out=np.zeros(len(p)), where=side > 0)  # 1/m
        return np.asarray(curvature[:, None, None] * around[:, :, None] * around[:, None, :])

    def closest_points(self, p: Array) -> Array:
        closest = _box_closest_point(self._face_excess(p))
        end = np.where(p[:, 2] < 0.0, -1.0, 1.0)
        z = end * (closest[:, 1] + self.height / 2.0)  # m
        return (closest[:, 0] + self.radius)[:, None] * self._radial_directions(p) + z[:, None] * [0.0, 0.0, 1.0]

    @property
    def primitive_parameters(self) -> tuple[str, float, float, float]:
        return "cylinder", self.radius, self.height / 2.0, 0.0


@dataclass(frozen=True, eq=False, slots=True)
class Box(Solid):
    """Box with its edges along the axes.

    Args:
        edges: (3,) lengths of the edges along x, y and z, m, > 0.

    Raises:
        InvalidInput: not three positive numbers.
    """

    edges: Array
    _places_without_normal: ClassVar[str] = "on an edge or a corner"

    if TYPE_CHECKING:  # the constructor accepts more types than the field has

        def __init__(self, edges: npt.ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        set_fields(self, edges=arrays.check_array(self.edges, "edges", (3,), above=0.0))

    @property
    def _largest_half_extent(self) -> float:
        return float(self.edges.max()) / 2.0

    @property
    def volume(self) -> float:
        return float(self.edges.prod())

    @property
    def _mean_products(self) -> Array:
        return np.diag(self.edges**2 / 12.0)

    def _face_excess(self, p: Array) -> Array:
        """Return the distances (N, 3) beyond the nearer face on each axis, m."""
        return np.abs(p) - self.edges / 2.0

    def _phi(self, p: Array) -> Array:
        return _box_distance(self._face_excess(p))

    def _gradient(self, p: Array) -> Array:
        return _box_face(self._face_excess(p), SURFACE_TOLERANCE * self._largest_half_extent) * np.where(p < 0.0, -1.0, 1.0)

    def _hessian(self, p: Array) -> Array:
        return np.zeros((len(p), 3, 3))

    def closest_points(self, p: Array) -> Array:
        return np.asarray(np.where(p < 0.0, -1.0, 1.0) * (_box_closest_point(self._face_excess(p)) + self.edges / 2.0))

    @property
    def primitive_parameters(self) -> tuple[str, float, float, float]:
        x, y, z = self.edges.tolist()
        return "box", x / 2.0, y / 2.0, z / 2.0


def _box_distance(q: Array) -> Array:
    """Return the signed distances (N,) from a box, given the distances q (N, 2 or 3) beyond each pair of faces."""
    outside = np.maximum(q, 0.0)
    distance = np.zeros(len(q))
    for column in outside.T:
        distance = np.hypot(distance, column)
    return np.asarray(distance + np.minimum(q.max(axis=1), 0.0))


def _box_face(q: Array, tolerance: float) -> Array:
    """Return one for the face that a point belongs to and zero for the others (N, 2 or 3); zeros on an edge."""
    ranked = np.sort(q, axis=1)
    edge = (np.abs(ranked[:, -1]) <= tolerance) & (ranked[:, -2] >= -tolerance)
    return np.where(edge[:, None], 0.0, np.eye(q.shape[1])[q.argmax(axis=1)])


def _box_closest_point(q: Array) -> Array:
    """Return the closest points of a box, as distances beyond its faces (N, 2 or 3).

    From outside, positive distances become zero. From inside, the one closest to zero does.
    """
    inside = q.max(axis=1, keepdims=True) < 0.0
    face = np.eye(q.shape[1])[q.argmax(axis=1)] > 0
    return np.where(inside & face, 0.0, np.minimum(q, 0.0))
