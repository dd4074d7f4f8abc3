"""Bodies of a collision scene: shapes on links, the object and obstacles, as geometry of the library coal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import coal
import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.geometry import Box, Cylinder, Shape, Sphere, Superquadric, TriangleMesh
from graspforce.hand.shapes.shape_geometry import extent

_GRID = 16  # points of a superquadric along a quarter of a meridian; the hull of an ellipsoid is inside by 0.12 % of its size

_KINDS = {"sphere": coal.Sphere, "box": coal.Box, "cylinder": coal.Cylinder, "capsule": coal.Capsule}
_REQUEST = coal.DistanceRequest(True)  # with nearest points


@dataclass(frozen=True, eq=False, slots=True)
class CollisionBody:
    """A convex geometry G that is fixed to a frame F, with a box and a sphere around it.

    Attributes:
        name: name of the URDF link, "object", or the name of an obstacle.
        frame: index of the frame in a scene.
        geometry: geometry of coal.
        p_FG: (3,) position of the geometry in F, m.
        R_FG: (3, 3) axes of the geometry, and of the box, in F.
        p_FB: (3,) centre of the box and the sphere in F, m.
        half_extents: (3,) of the box, m.
        radius: of the sphere, m.
        kind: "sphere", "box", "cylinder", "capsule", or "hull" for a convex hull of points.
    """

    name: str
    frame: int
    geometry: Any
    p_FG: Array
    R_FG: Array
    p_FB: Array
    half_extents: Array
    radius: float
    kind: str

    @classmethod
    def of_geometry(cls, name: str, frame: int, geometry: Any, p_FG: Array, R_FG: Array) -> CollisionBody:
        """Return the body of a geometry.

        Args:
            name: name of the body.
            frame: index of its frame.
            geometry: geometry of coal, as `coal_geometry` and `object_geometry` return it.
            p_FG: (3,) position of the geometry in F, m.
            R_FG: (3, 3) axes of the geometry in F.
        """
        low, high = extent(geometry)
        half, kind = (high - low) / 2.0, next((name for name, each in _KINDS.items() if isinstance(geometry, each)), "hull")
        p_FG, R_FG = np.array(p_FG), np.array(R_FG)
        radius = float(geometry.radius) if kind == "sphere" else float(np.linalg.norm(half))
        p_FB = p_FG + R_FG @ ((low + high) / 2.0)
        return cls(name, frame, geometry, freeze(p_FG), freeze(R_FG), freeze(p_FB), freeze(half), radius, kind)

    @property
    def hull_points(self) -> Array:
        """Corners (M, 3) of a convex hull in G, m."""
        return freeze(np.array(self.geometry.points()))


def object_geometry(shape: Shape | None) -> Any | None:
    """Return the geometry of an object in its own axes; None for no shape and for implicit surfaces.

    A superquadric becomes the convex hull of points on its surface, and a mesh the convex hull of its vertices.

    Args:
        shape: surface of the object.
    """
    if isinstance(shape, Sphere):
        return coal.Sphere(shape.radius)
    if isinstance(shape, Cylinder):
        return coal.Cylinder(shape.radius, shape.height)
    if isinstance(shape, Box):
        return coal.Box(*shape.edges.tolist())
    if isinstance(shape, Superquadric):
        return _convex_hull(_superquadric_points(shape))
    if isinstance(shape, TriangleMesh):
        return _convex_hull(shape.vertices)
    return None


def place(body: CollisionBody, p: Array, R: Array) -> Any:
    """Return the pose of a body's geometry, as coal needs it.

    Args:
        body: the body.
        p: (3,) position of its frame, m.
        R: (3, 3) axes of its frame.
    """
    return coal.Transform3s(np.asarray(R @ body.R_FG), np.asarray(p + R @ body.p_FG))


def signed_distance(one: CollisionBody, one_place: Any, other: CollisionBody, other_place: Any) -> tuple[float, Array]:
    """Return the distance of two bodies, m, negative for an overlap, and the nearest points (2, 3), m.

    Args:
        one: one body.
        one_place: its place, as `place` returns it.
        other: the other body.
        other_place: its place.
    """
    result = coal.DistanceResult()
    distance = float(coal.distance(one.geometry, one_place, other.geometry, other_place, _REQUEST, result))
    return distance, np.array((result.getNearestPoint1(), result.getNearestPoint2()))


def _superquadric_points(shape: Superquadric) -> Array:
    """Return points on a superquadric (N, 3), m, evenly spaced in the angles of its parametric form."""
    e1, e2 = shape.exponents
    up = np.linspace(-np.pi / 2.0, np.pi / 2.0, 2 * _GRID + 1)[:, None]
    around = np.linspace(-np.pi, np.pi, 4 * _GRID, endpoint=False)[None]

    def power(x: Array, e: float) -> Array:
        return np.asarray(np.sign(x) * np.abs(x) ** e)

    across = power(np.cos(up), e1)
    unit = np.broadcast_arrays(across * power(np.cos(around), e2), across * power(np.sin(around), e2), power(np.sin(up), e1))
    return np.unique(np.round(shape.axes * np.stack(unit, axis=-1).reshape(-1, 3), 9), axis=0)


def _convex_hull(points: Array) -> Any:
    """Return the convex hull of points (N, 3), m."""
    vertices = coal.StdVec_Vec3s()
    vertices.extend(list(points))
    return coal.ConvexBase.convexHull(vertices, True, "Qt")
