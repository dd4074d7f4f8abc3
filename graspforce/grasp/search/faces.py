"""Faces of a shape: smooth pieces of its surface, each with a signed distance that continues beyond its edges.

A surface has no normal on an edge. The search assigns a face to each finger. It can then slide the object along the face
without meeting the kink at the edge, and penalise a small distance to the edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry import Box, Cylinder, Solid, Sphere

_TINY = 1e-300
_ROUGH_STEPS = 3  # along ∇φ
_LEAST_STRETCH = 0.1  # of 1 + d S: near a centre of curvature the normal has no bounded slope
_BOX_NORMALS = np.vstack([np.eye(3), -np.eye(3)])  # outward normals of a box's faces


@dataclass(frozen=True, eq=False, slots=True)
class FaceDistances:
    """Distances of M points from the P faces of a shape.

    Attributes:
        face_distance: (M, P) signed distance from each face extended beyond its edges, m; negative inside.
        normal: (M, P, 3) inward normal of each face at its nearest point, in O.
        edge_distance: (M, P) distance of that nearest point from the edge of the face, m; negative beyond the edge, inf for a
            face without an edge.
    """

    face_distance: Array
    normal: Array
    edge_distance: Array


@dataclass(frozen=True, eq=False, slots=True)
class FaceTangents:
    """Distances from the one face of a curved shape near M points, to first order.

    The outward normal n = ∇d of a distance d changes by ∂n/∂x = S (1 + d S)⁻¹ with the shape operator S at the closest point.

    Attributes:
        p: (M, 3) the points in O, m.
        faces: distances of the points.
        slope: (M, 3, 3) ∂n/∂x, 1/m.
    """

    p: Array
    faces: FaceDistances
    slope: Array

    def at(self, p: Array) -> FaceDistances:
        """Compute the distances of B points near each of the M points.

        Args:
            p: (B M, 3) points in O, m, M by M.
        """
        d = p.reshape(-1, *self.p.shape) - self.p
        out = -self.faces.normal[:, 0]
        distance = self.faces.face_distance[:, 0] + (d * out).sum(axis=2)
        normal = out + (self.slope @ d[..., None])[..., 0]
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
        return FaceDistances(distance.reshape(-1, 1), -normal.reshape(-1, 1, 3), np.full((len(p), 1), np.inf))


def face_tangents(shape: Solid, p: Array) -> FaceTangents | None:
    """Compute the tangents of a curved shape's face at points; None for a sphere, cylinder or box, which need none.

    Args:
        shape: the object's surface.
        p: (M, 3) points in O, m.
    """
    if isinstance(shape, (Box, Cylinder, Sphere)):
        return None
    x = np.asarray(shape.closest_points(p))
    gradient = shape._gradient(x)
    size = np.maximum(np.linalg.norm(gradient, axis=1), _TINY)
    out = gradient / size[:, None]
    depth = ((p - x) * out).sum(axis=1)  # m
    flat = np.eye(3) - out[:, :, None] * out[:, None]
    H = shape._hessian(x)
    H = np.where(np.isfinite(H).all(axis=(1, 2), keepdims=True), H, 0.0)  # without curvature at a kink
    S = flat @ H @ flat / size[:, None, None]
    values, axes = np.linalg.eigh(S)
    values = values / np.maximum(1.0 + depth[:, None] * values, _LEAST_STRETCH)
    slope = (axes * values[:, None]) @ axes.swapaxes(1, 2)
    return FaceTangents(p, FaceDistances(depth[:, None], -out[:, None], np.full((len(p), 1), np.inf)), slope)


def face_distances(shape: Solid, p: Array) -> FaceDistances:
    """Compute the distances of points from the faces of a shape.

    A box has six faces, a cylinder three (side, upper end, lower end). Every other shape counts as one face without an edge.

    Args:
        shape: the object's surface.
        p: (M, 3) points in O, m.
    """
    if isinstance(shape, Box):
        return _box(shape.edges / 2.0, p)
    if isinstance(shape, Cylinder):
        return _cylinder(shape.radius, shape.height / 2.0, p)
    if not isinstance(shape, Sphere):
        return _smooth(shape, p)
    distance = np.linalg.norm(p, axis=1)[:, None]
    out = np.divide(p, distance, out=np.zeros_like(p), where=distance > 0.0)
    return FaceDistances(distance - shape.radius, -out[:, None, :], np.full((len(p), 1), np.inf))


def rough_face_distances(shape: Solid, p: Array) -> FaceDistances:
    """Compute the distances of points from the faces of a shape, for a first choice among many candidates.

    On a curved shape, steps along ∇φ replace the search of the closest point.

    Args:
        shape: the object's surface.
        p: (M, 3) points in O, m.
    """
    if isinstance(shape, (Box, Cylinder, Sphere)):
        return face_distances(shape, p)
    x = p
    for _ in range(_ROUGH_STEPS):
        gradient = shape._gradient(x)
        x = x - (shape.phi(x) / np.maximum((gradient * gradient).sum(axis=1), _TINY))[:, None] * gradient
    return _from_closest(shape, p, x)


def _smooth(shape: Solid, p: Array) -> FaceDistances:
    return _from_closest(shape, p, np.asarray(shape.closest_points(p)))


def _from_closest(shape: Solid, p: Array, x: Array) -> FaceDistances:
    """Return the distances of points p from the tangent planes at points x of the surface."""
    gradient = shape._gradient(x)
    normal = -gradient / np.maximum(np.linalg.norm(gradient, axis=1), _TINY)[:, None]
    depth = ((x - p) * normal).sum(axis=1)[:, None]  # m, positive outside; at a kink shorter than the distance
    return FaceDistances(depth, normal[:, None], np.full((len(p), 1), np.inf))


def _box(half: Array, p: Array) -> FaceDistances:
    face_distance = p @ _BOX_NORMALS.T - np.tile(half, 2)
    inside = half - np.abs(p)  # m, from the nearer face of each pair
    others = np.stack([np.minimum(inside[:, (k + 1) % 3], inside[:, (k + 2) % 3]) for k in range(3)], axis=1)
    return FaceDistances(face_distance, np.broadcast_to(-_BOX_NORMALS, (len(p), 6, 3)), np.tile(others, (1, 2)))


def _cylinder(radius: float, half: float, p: Array) -> FaceDistances:
    rho = np.hypot(p[:, 0], p[:, 1])  # m, from the axis
    out = np.where(rho[:, None] > 0.0, p * [1.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    out = out / np.linalg.norm(out, axis=1)[:, None]
    ends = np.broadcast_to([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], (len(p), 2, 3))  # inward normals: upper end, lower end
    return FaceDistances(
        face_distance=np.column_stack([rho - radius, p[:, 2] - half, -p[:, 2] - half]),
        normal=np.concatenate([-out[:, None, :], ends], axis=1),
        edge_distance=np.column_stack([half - np.abs(p[:, 2]), radius - rho, radius - rho]),
    )
