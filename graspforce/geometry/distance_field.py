"""Smooth signed distance from a closed triangle mesh, on a grid.

At the nodes x_i of a grid with spacing h, d_i is the signed distance from the mesh. Between them,

    φ(x) = Σ_i d_i B((x − x_i)/h),

with the tensor product B of cubic B-splines. φ has two continuous derivatives, so normals and curvatures exist everywhere:
edges are rounded at a radius of about h. A flat face is exact; a surface of curvature κ is displaced by about h² κ/6.

The sign follows from the angle-weighted normal of the nearest face, edge or vertex. Source: Bærentzen and Aanæs (2005).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.geometry.vectors import row_norms

Faces = npt.NDArray[np.intp]  # (F, 3) indices of vertices

_BAND = 3  # spacings on both sides of the surface in which distances are exact
_PADDING = _BAND + 2  # spacings between the mesh and the border of the grid
_OFFSETS = np.arange(4)
# coefficients of 1, t, t², t³ of the four B-splines around t, then of their first and second derivatives
_SPLINE = (
    np.hstack(
        [
            [[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]],
            [[-3.0, 0.0, 3.0, 0.0], [6.0, -12.0, 6.0, 0.0], [-3.0, 9.0, -9.0, 3.0], [0.0, 0.0, 0.0, 0.0]],
            [[6.0, -12.0, 6.0, 0.0], [-6.0, 18.0, -18.0, 6.0], [0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]],
        ]
    )
    / 6.0
)
_MAX_PAIRS = 500_000  # of nodes and faces that are computed together, for bounded memory
_SECOND = tuple((a, b, tuple((a == k) + (b == k) for k in range(3))) for a in range(3) for b in range(a + 1))


@dataclass(frozen=True, eq=False, slots=True)
class DistanceField:
    """A smooth level function on a grid.

    Attributes:
        origin: (3,) position of the first node, m.
        spacing: h, m.
        distances: (K, L, M) signed distances at the nodes, m; negative inside.
    """

    origin: Array
    spacing: float
    distances: Array

    def value(self, p: Array) -> Array:
        """Return φ (N,) at points, m.

        Args:
            p: (N, 3) points, m. Outside the grid φ grows by the distance from it, and exceeds the distance.
        """
        from scipy import ndimage  # here, because every import of graspforce would load SciPy

        u = (p - self.origin) / self.spacing
        inside = np.clip(u, 1.0, np.array(self.distances.shape) - 2.0)  # where four nodes surround a point along each axis
        phi = ndimage.map_coordinates(self.distances, inside.T, order=3, prefilter=False, mode="nearest")
        return np.asarray(phi + self.spacing * row_norms(u - inside))

    def derivatives(self, p: Array) -> tuple[Array, Array, Array]:
        """Return φ (N,), m, ∇φ (N, 3) and ∂²φ/∂x² (N, 3, 3), 1/m, at points.

        Args:
            p: (N, 3) points, m. Outside the grid ∇φ points away from it.
        """
        size = np.array(self.distances.shape)
        u = (p - self.origin) / self.spacing
        inside = np.clip(u, 1.0, size - 2.0)  # where four nodes surround a point along each axis
        first = np.minimum(np.floor(inside).astype(np.intp), size - 3) - 1
        weights = _spline_weights(inside - first - 1.0, self.spacing)  # (N, axis, order, 4)
        strides = size[1] * size[2], size[2], 1
        block = (_OFFSETS[:, None, None] * strides[0] + _OFFSETS[:, None] * strides[1] + _OFFSETS).ravel()
        sums = self.distances.ravel()[(first @ strides)[:, None] + block].reshape(-1, 16, 4)
        sums = (sums @ weights[:, 2].swapaxes(1, 2)).reshape(-1, 4, 4, 3)  # orders along z
        sums = (weights[:, 1, None] @ sums).reshape(-1, 4, 9)  # and along y
        sums = (weights[:, 0] @ sums).reshape(-1, 3, 3, 3)  # and along x
        g, H = np.stack([sums[:, 1, 0, 0], sums[:, 0, 1, 0], sums[:, 0, 0, 1]], axis=1), np.empty((len(p), 3, 3))
        for a, b, order in _SECOND:
            H[:, a, b] = H[:, b, a] = sums[:, order[0], order[1], order[2]]
        beyond = (u - inside) * self.spacing  # m
        away = row_norms(beyond)
        is_outside = away > 0.0
        g[is_outside] = beyond[is_outside] / away[is_outside, None]
        return sums[:, 0, 0, 0] + away, g, H


def build_distance_field(vertices: Array, faces: Faces, spacing: float) -> DistanceField:
    """Return the smooth signed distance from a closed mesh whose faces are counter-clockwise seen from outside.

    Args:
        vertices: (V, 3) positions, m.
        faces: (F, 3) indices of vertices.
        spacing: h, m.
    """
    from scipy import ndimage  # here, because every import of graspforce would load SciPy

    lower = vertices.min(axis=0) - _PADDING * spacing
    size = np.ceil((vertices.max(axis=0) + _PADDING * spacing - lower) / spacing).astype(np.intp) + 1
    corners = vertices[faces]
    first = np.maximum(np.floor((corners.min(axis=1) - lower) / spacing).astype(np.intp) - _BAND, 0)
    counts = np.minimum(np.ceil((corners.max(axis=1) - lower) / spacing).astype(np.intp) + _BAND + 1, size) - first
    squared, sign = np.full(size, np.inf).ravel(), np.zeros(size).ravel()
    normals = _feature_normals(vertices, faces)
    for shape in np.unique(counts, axis=0):  # faces with blocks of nodes of the same shape are computed together
        alike = np.flatnonzero((counts == shape).all(axis=1))
        block = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
        for some in np.array_split(alike, len(alike) * len(block) // _MAX_PAIRS + 1):
            nodes = (first[some, None] + block).reshape(-1, 3)
            owner = np.repeat(some, len(block))
            p = lower + spacing * nodes
            closest, feature = closest_on_triangles(p, corners[owner])
            d2 = ((p - closest) ** 2).sum(axis=1)
            index = np.ravel_multi_index(tuple(nodes.T), tuple(size))
            before = squared[index]
            np.minimum.at(squared, index, d2)
            nearest = (d2 == squared[index]) & (d2 < before)
            side = ((p[nearest] - closest[nearest]) * normals[owner[nearest], feature[nearest]]).sum(axis=1)
            sign[index[nearest]] = np.sign(side)
    squared, sign = squared.reshape(size), sign.reshape(size)
    is_near = squared <= (_BAND * spacing) ** 2
    distances = np.where(is_near, np.where(sign < 0.0, -1.0, 1.0) * np.sqrt(np.where(is_near, squared, 0.0)), 0.0)
    way, nearest = ndimage.distance_transform_edt(~is_near, sampling=spacing, return_indices=True)
    at_band = distances[tuple(nearest)]  # the way from a node to the band does not cross the surface
    return DistanceField(lower, spacing, at_band + np.sign(at_band) * way)


def closest_on_triangles(p: Array, corners: Array) -> tuple[Array, npt.NDArray[np.intp]]:
    """Return the closest point of each triangle to its point, and the feature on which it lies.

    Source: Ericson (2005), section 5.1.5.

    Args:
        p: (N, 3) points, m.
        corners: (N, 3, 3) corners a, b, c of the triangles, m.

    Returns:
        Points (N, 3), m, and features (N,): 0 for the face; 1, 2, 3 for the edges ab, bc, ca; 4, 5, 6 for the corners a, b, c.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, bc = b - a, c - a, c - b
    d1, d2 = _dot(p - a, ab), _dot(p - a, ac)
    d3, d4 = _dot(p - b, ab), _dot(p - b, ac)
    d5, d6 = _dot(p - c, ab), _dot(p - c, ac)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    with np.errstate(divide="ignore", invalid="ignore"):
        area = va + vb + vc
        closest = a + (vb / area)[:, None] * ab + (vc / area)[:, None] * ac
        cases = [
            ((va <= 0.0) & (d4 >= d3) & (d5 >= d6), b + ((d4 - d3) / ((d4 - d3) + (d5 - d6)))[:, None] * bc, 2),
            ((vb <= 0.0) & (d2 >= 0.0) & (d6 <= 0.0), a + (d2 / (d2 - d6))[:, None] * ac, 3),
            ((d6 >= 0.0) & (d5 <= d6), c, 6),
            ((vc <= 0.0) & (d1 >= 0.0) & (d3 <= 0.0), a + (d1 / (d1 - d3))[:, None] * ab, 1),
            ((d3 >= 0.0) & (d4 <= d3), b, 5),
            ((d1 <= 0.0) & (d2 <= 0.0), a, 4),
        ]
    feature = np.zeros(len(p), dtype=np.intp)
    for condition, points, index in cases:  # a later case replaces an earlier one
        closest[condition], feature[condition] = points[condition], index
    return closest, feature


def _dot(x: Array, y: Array) -> Array:
    """Return the scalar products of rows, (N,)."""
    return np.asarray(np.einsum("ni,ni->n", x, y))


def _feature_normals(vertices: Array, faces: Faces) -> Array:
    """Return for each face the outward normals of its features, (F, 7, 3), in the order of `closest_on_triangle`."""
    corners = vertices[faces]
    edges = np.roll(corners, -1, axis=1) - corners  # ab, bc, ca
    normal = np.cross(edges[:, 0], -edges[:, 2])
    normal /= row_norms(normal)[:, None]
    result = np.empty((len(faces), 7, 3))
    result[:, 0] = normal
    owner = {(int(i), int(j)): f for f, face in enumerate(faces) for i, j in zip(face, np.roll(face, -1), strict=True)}
    for f, face in enumerate(faces):
        for e in range(3):
            result[f, 1 + e] = normal[f] + normal[owner[int(face[(e + 1) % 3]), int(face[e])]]
    unit = edges / np.linalg.norm(edges, axis=2, keepdims=True)
    angles = np.arccos(np.clip(-(unit * np.roll(unit, 1, axis=1)).sum(axis=2), -1.0, 1.0))  # rad, at each corner
    at_vertex = np.zeros_like(vertices)
    np.add.at(at_vertex, faces.ravel(), (angles[:, :, None] * normal[:, None]).reshape(-1, 3))
    result[:, 4:] = at_vertex[faces]
    return result


def _spline_weights(t: Array, spacing: float) -> Array:
    """Return the weights (N, axis, order, 4) of the cubic B-spline and its two derivatives at t (N, 3) in [0, 1]."""
    powers = np.stack([np.ones_like(t), t, t * t, t * t * t], axis=-1)  # (N, axis, 4)
    scale = spacing ** -np.arange(3.0)
    return np.asarray((powers @ _SPLINE).reshape(*t.shape, 3, 4) * scale[:, None])
