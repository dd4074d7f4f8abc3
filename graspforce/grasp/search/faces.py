"""The faces of a shape: smooth pieces of its surface, each with a level that goes on beyond its edges.

On an edge a surface has no normal, so a finger is told on which face it stands: a search can then slide the object along the
face without meeting the edge's kink, and see how much room there is to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry import Box, Cylinder, Sphere

# Their φ is the distance in closed form. A search asks for it a million times: one that is itself a search takes too long.
ClosedFormShape = Sphere | Cylinder | Box


@dataclass(frozen=True, eq=False, slots=True)
class Faces:
    """What M points see of the P faces of a shape.

    Attributes:
        level: (M, P) signed distance from each face, its edges left out, m; negative on the object's side.
        normal: (M, P, 3) the face's inward normal where it is nearest, in O.
        room: (M, P) how far inside the face's edges the nearest point of it lies, m; inf where the face has no edge.
    """

    face_distance: Array
    normal: Array
    edge_distance: Array


def faces(shape: ClosedFormShape, p: Array) -> Faces:
    """The faces of a box are its six sides, of a cylinder its side and its two ends; a sphere is one face without an edge.

    Args:
        shape: the object's surface.
        p: (M, 3) points in O, m.
    """
    if isinstance(shape, Box):
        return _box(shape.edges / 2.0, p)
    if isinstance(shape, Cylinder):
        return _cylinder(shape.radius, shape.height / 2.0, p)
    distance = np.linalg.norm(p, axis=1)[:, None]
    out = np.divide(p, distance, out=np.zeros_like(p), where=distance > 0.0)
    return Faces(distance - shape.radius, -out[:, None, :], np.full((len(p), 1), np.inf))


_SIDES = np.vstack([np.eye(3), -np.eye(3)])  # the outward normals of a box's faces


def _box(half: Array, p: Array) -> Faces:
    face_distance = p @ _SIDES.T - np.tile(half, 2)
    inside = half - np.abs(p)  # m, from each pair of faces
    others = np.stack([np.minimum(inside[:, (k + 1) % 3], inside[:, (k + 2) % 3]) for k in range(3)], axis=1)
    return Faces(face_distance, np.broadcast_to(-_SIDES, (len(p), 6, 3)), np.tile(others, (1, 2)))


def _cylinder(radius: float, half: float, p: Array) -> Faces:
    rho = np.hypot(p[:, 0], p[:, 1])
    out = np.where(rho[:, None] > 0.0, p * [1.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    out = out / np.linalg.norm(out, axis=1)[:, None]
    ends = np.broadcast_to([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], (len(p), 2, 3))  # inward, of the upper and the lower end
    return Faces(
        face_distance=np.column_stack([rho - radius, p[:, 2] - half, -p[:, 2] - half]),
        normal=np.concatenate([-out[:, None, :], ends], axis=1),
        edge_distance=np.column_stack([half - np.abs(p[:, 2]), radius - rho, radius - rho]),
    )
