"""The shapes of a URDF link as geometry of the library coal: for distances, and for volumes and their moments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import ModelError
from graspforce.hand.descriptions.urdf import UrdfShape
from graspforce.hand.shapes.meshes import Directories, find_mesh_file

_POINT_RADIUS = 1e-6  # m
_SOLID_SHARES = (0.1, 1.01)  # of a mesh's volume in that of its convex hull; a mesh outside is not closed


@dataclass(frozen=True, eq=False, slots=True)
class SolidMoments:
    """The volume of a body and its moments.

    Attributes:
        volume: m³.
        centroid: (3,) m.
        second_moments: (3, 3) inertia about the centroid at density 1, m⁵.
    """

    volume: float
    centroid: Array
    second_moments: Array


def coal_geometry(shape: UrdfShape, urdf: Path, directories: Directories = ()) -> Any:
    """Return the geometry of a shape in the shape's own axes; of a mesh, its convex hull.

    Args:
        shape: box, sphere, cylinder, capsule or mesh.
        urdf: path of the URDF, for its mesh files.
        directories: directories to search for meshes first; see `find_mesh_file`.

    Raises:
        ModelError: the mesh is not found or cannot be read, or the shape is of an unknown kind.
    """
    if shape.mesh is not None:
        return _load_mesh(shape, urdf, directories).convex
    if shape.size is None:
        raise ModelError(f"{urdf}: a <{shape.kind}> is not a box, sphere, cylinder, capsule or mesh")
    x, _, z = (float(length) for length in shape.size)  # m, full extents
    if shape.kind == "box":
        return coal.Box(*(float(length) for length in shape.size))
    if shape.kind == "sphere":
        return coal.Sphere(x / 2.0)
    return coal.Capsule(x / 2.0, z - x) if shape.kind == "capsule" else coal.Cylinder(x / 2.0, z)


def outer_points(shape: UrdfShape, urdf: Path, directories: Directories = ()) -> Array:
    """Return points (M, 3) on the convex hull of a shape, in its link's axes, m.

    Args:
        shape: the shape.
        urdf: path of the URDF, for its mesh files.
        directories: directories to search for meshes first; see `find_mesh_file`.

    Raises:
        ModelError: the mesh is not found or cannot be read, or the shape is of an unknown kind.
    """
    geometry = coal_geometry(shape, urdf, directories)
    if shape.mesh is not None:
        points = np.asarray(geometry.points())
    else:
        half = np.asarray(shape.size) / 2.0
        u = _directions()
        if shape.kind == "box":
            points = np.sign(u) * half
        elif shape.kind == "sphere":
            points = u * half
        else:  # a capsule is a cylinder with round ends
            rim = u[:, :2] / np.linalg.norm(u[:, :2], axis=1, keepdims=True) * half[:2]
            points = np.column_stack([rim, np.sign(u[:, 2]) * half[2]])
            if shape.kind == "capsule":
                points = u * half[0] + np.sign(u[:, 2])[:, None] * [0.0, 0.0, half[2] - half[0]]
    return np.asarray(shape.p + points @ shape.R.T)


def diagonal_of_shapes(shapes: Sequence[UrdfShape], urdf: Path, directories: Directories = ()) -> float:
    """Return the diagonal of the box around shapes of one link, along the link's axes, m.

    Args:
        shapes: shapes of one link, at least one.
        urdf: path of the URDF, for its mesh files.
        directories: directories to search for meshes first; see `find_mesh_file`.

    Raises:
        ModelError: a mesh is not found or cannot be read, or a shape is of an unknown kind.
    """
    points = np.concatenate([outer_points(shape, urdf, directories) for shape in shapes])
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _directions(count: int = 200) -> Array:
    """Return unit vectors (count, 3) on a golden spiral."""
    k = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    return np.column_stack([np.sqrt(1.0 - z * z) * np.cos(angle), np.sqrt(1.0 - z * z) * np.sin(angle), z])


def solid_moments(shapes: Sequence[UrdfShape], urdf: Path, directories: Directories = ()) -> SolidMoments:
    """Return volume and moments of some shapes of one link, in the link's axes. Overlaps count twice.

    Args:
        shapes: shapes of one link.
        urdf: path of the URDF, for its mesh files.
        directories: directories to search for meshes first; see `find_mesh_file`.

    Raises:
        ModelError: a mesh is not found or cannot be read, or the shapes have no volume.
    """
    volumes, centres, moments = [], [], []
    for shape in shapes:
        geometry = coal_geometry(shape, urdf, directories)
        if shape.mesh is not None:
            mesh = _load_mesh(shape, urdf, directories)
            share = mesh.computeVolume() / geometry.computeVolume()
            geometry = mesh if _SOLID_SHARES[0] <= share <= _SOLID_SHARES[1] else geometry
        volumes.append(float(geometry.computeVolume()))
        centres.append(shape.p + shape.R @ np.asarray(geometry.computeCOM()).reshape(3))
        moments.append(shape.R @ np.asarray(geometry.computeMomentofInertiaRelatedToCOM()) @ shape.R.T)
    volume = sum(volumes)
    if not volume > 0.0:
        raise ModelError(f"{urdf}: the shapes have no volume")
    centroid = np.asarray(volumes) @ np.asarray(centres) / volume
    total = np.zeros((3, 3))
    for V, centre, I_own in zip(volumes, centres, moments, strict=True):  # the parallel axis theorem
        d = centre - centroid
        total += I_own + V * (d @ d * np.eye(3) - np.outer(d, d))
    return SolidMoments(volume, freeze(centroid), freeze(total))


def distance_to_shapes(p: Array, shapes: Sequence[UrdfShape], urdf: Path) -> float:
    """Return the distance of a point from the nearest of some shapes of one link, m; negative inside, infinite without shapes.

    Args:
        p: (3,) point in the link's frame, m.
        shapes: shapes in the link's frame.
        urdf: path of the URDF, for its mesh files.

    Raises:
        ModelError: a mesh is not found or cannot be read.
    """
    request, result, point = coal.DistanceRequest(), coal.DistanceResult(), coal.Sphere(_POINT_RADIUS)
    least = np.inf
    for shape in shapes:
        result.clear()
        place = coal.Transform3s(np.array(shape.R), np.array(shape.p))
        distance = coal.distance(coal_geometry(shape, urdf), place, point, coal.Transform3s(np.eye(3), p), request, result)
        least = min(least, float(distance) + _POINT_RADIUS)
    return least


def extent(geometry: Any) -> tuple[Array, Array]:
    """Return the least and largest corner (3,) of a geometry's bounding box in its own axes, m.

    Args:
        geometry: as `coal_geometry` returns it.
    """
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    return np.array(box.min_), np.array(box.max_)


def _load_mesh(shape: UrdfShape, urdf: Path, directories: Directories) -> Any:
    """Return the mesh of a shape, with its convex hull."""
    if shape.mesh is None:
        raise ModelError(f"{urdf}: a <{shape.kind}> has no mesh")
    file = find_mesh_file(shape.mesh.name, urdf, directories)
    try:
        mesh = coal.MeshLoader().load(str(file), np.array(shape.mesh.scale))
        mesh.buildConvexHull(True, "Qt")
    except (RuntimeError, ValueError) as error:
        raise ModelError(f"{urdf}: the mesh {file} cannot be read: {error}") from None
    return mesh
