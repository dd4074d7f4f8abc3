"""Triangle mesh: any closed surface, given by vertices and faces, with smooth normals and curvatures.

The surface for contacts is the zero set of a smooth signed distance φ; see `graspforce.geometry.distance_field`. Volume, centre
and inertia are those of the mesh itself, by Gauss's theorem.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, ModelError
from graspforce.core.optional_libraries import optional_imports
from graspforce.core.records import set_fields
from graspforce.geometry.distance_field import DistanceField, Faces, build_distance_field
from graspforce.geometry.shape import SURFACE_TOLERANCE, Solid
from graspforce.geometry.vectors import row_norms

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MAX_VERTICES = 20_000
MAX_FACES = 40_000
_DEFAULT_CELLS = 64  # spacings along the largest extent
_MAX_CELLS = 400
_MAX_STEPS = 100  # of Newton's method
_SURFACE_STEPS = 5  # of Newton's method along ∇φ
_LEAST_CURVATURE = 0.1  # of the squared distance along the surface
_TINY = 1e-300
_MAX_STEP = 2.0  # spacings, of one Newton step
_CONVERGED = 1e-9  # of the largest extent, of a full Newton step: the next one would be its square


@dataclass(frozen=True, eq=False, slots=True)
class TriangleMesh(Solid):
    """Closed surface of triangles.

    Args:
        vertices: (V, 3) positions in O, m; at most 20,000. O is anywhere.
        faces: (F, 3) indices of vertices, counter-clockwise seen from outside; at most 40,000. Every edge belongs to two faces.
        spacing: distance of the grid nodes on which the surface is smoothed, m, > 0; edges are rounded at a radius of about
            this. None for 1/64 of the largest extent.

    Raises:
        InvalidInput: the mesh is not closed, is inside out, or has too many or wrong vertices or faces; names the first place.
    """

    vertices: Array
    faces: Faces
    spacing: float | None = None
    _field: DistanceField = field(init=False, repr=False)
    _tree: cKDTree = field(init=False, repr=False)
    _places_without_normal: ClassVar[str] = "on the medial axis"
    type_name: ClassVar[str] = "mesh"

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(self, vertices: npt.ArrayLike, faces: npt.ArrayLike, spacing: float | None = None) -> None: ...

    def __post_init__(self) -> None:
        vertices = arrays.check_array(self.vertices, "vertices", (None, 3))
        if not 4 <= len(vertices) <= MAX_VERTICES:
            raise InvalidInput("vertices", f"{len(vertices)} vertices", f"from 4 to {MAX_VERTICES}")
        faces = _check_faces(self.faces, len(vertices))
        _check_closed(faces)
        extent = float(np.ptp(vertices, axis=0).max())
        spacing = extent / _DEFAULT_CELLS if self.spacing is None else arrays.check_number(self.spacing, "spacing", above=0.0)
        if extent > _MAX_CELLS * spacing:
            raise InvalidInput("spacing", spacing, f"at least {extent / _MAX_CELLS:.3g} m, a {_MAX_CELLS}th of the extent")
        set_fields(self, vertices=vertices, faces=faces, spacing=spacing)
        if self.volume <= 0.0:
            raise InvalidInput("faces", f"an enclosed volume of {self.volume:.3g} m³", "counter-clockwise seen from outside")
        from scipy.spatial import cKDTree  # here, because every import of graspforce would load SciPy

        set_fields(self, _field=build_distance_field(vertices, faces, spacing), _tree=cKDTree(vertices))

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, scale: float = 1.0, spacing: float | None = None) -> TriangleMesh:
        """Read a mesh from an STL, OBJ, PLY or OFF file. Needs ``pip install "graspforce[mesh]"``.

        Args:
            path: the file.
            scale: metres per unit of the file, > 0: 0.001 for millimetres.
            spacing: as above.

        Raises:
            MissingLibrary: trimesh is not installed.
            ModelError: the file cannot be read.
            InvalidInput: the mesh is not closed or too large.
        """
        with optional_imports():
            import trimesh
        factor = arrays.check_number(scale, "scale", above=0.0)
        try:
            mesh: Any = trimesh.load(os.fspath(path), force="mesh")
        except Exception as error:  # each format has exceptions of its own
            raise ModelError(f"{os.fspath(path)}: cannot read the mesh: {error}") from None
        if not len(mesh.faces):
            raise ModelError(f"{os.fspath(path)}: cannot read the mesh: it has no triangles")
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        mesh.update_faces(mesh.nondegenerate_faces())
        mesh.remove_unreferenced_vertices()
        repair: Any = trimesh.repair  # without types
        repair.fix_normals(mesh, multibody=True)
        try:
            return cls(factor * np.asarray(mesh.vertices), np.asarray(mesh.faces), spacing)
        except InvalidInput as error:
            raise error.with_prefix(os.fspath(path)) from None

    @property
    def _largest_half_extent(self) -> float:
        return float(np.ptp(self.vertices, axis=0).max()) / 2.0

    @property
    def volume(self) -> float:
        return float(_signed_volumes(self.vertices[self.faces]).sum())

    @property
    def centre(self) -> Array:
        """(3,) centre of the volume in O, m."""
        corners = self.vertices[self.faces]
        volumes = _signed_volumes(corners)
        return freeze(volumes @ corners.sum(axis=1) / (4.0 * volumes.sum()))

    @property
    def is_convex(self) -> bool:
        """Whether no vertex is above the plane of a face, to rounding."""
        corners = self.vertices[self.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= row_norms(normals)[:, None]
        heights = self.vertices @ normals.T - (corners[:, 0] * normals).sum(axis=1)
        return bool(heights.max() <= SURFACE_TOLERANCE * self._largest_half_extent)

    @property
    def _mean_products(self) -> Array:
        corners = self.vertices[self.faces] - self.centre
        volumes = _signed_volumes(corners)
        total = corners.sum(axis=1)
        products = np.einsum("f,fki,fkj->ij", volumes, corners, corners) + np.einsum("f,fi,fj->ij", volumes, total, total)
        return np.asarray(products / (20.0 * volumes.sum()))

    def _phi(self, p: Array) -> Array:
        return self._field.value(p)

    def _gradient(self, p: Array) -> Array:
        return self._field.derivatives(p)[1]

    def _hessian(self, p: Array) -> Array:
        return self._field.derivatives(p)[2]

    def closest_points(self, p: Array) -> Array:
        """Return the closest points of the smooth surface; a local minimum of the distance near the closest vertex.

        Newton's method solves x + λ ∇φ(x) = p, φ(x) = 0 from the closest vertex of the mesh.

        Args:
            p: (N, 3) points in O, m.
        """
        x = self._from_vertices(p)
        assert self.spacing is not None  # set by __post_init__
        longest, tolerance = _MAX_STEP * self.spacing, _CONVERGED * 2.0 * self._largest_half_extent  # m
        share, last = np.ones(len(p)), np.full(len(p), np.inf)  # of each step that is taken, and residual of the step before
        active = np.arange(len(p))  # points without convergence
        for _ in range(_MAX_STEPS):
            here, to = x[active], p[active]
            phi, g, H = self._field.derivatives(here)
            lam = ((to - here) * g).sum(axis=1) / (g * g).sum(axis=1)
            residual = to - here - lam[:, None] * g  # m, along the surface
            size = row_norms(residual) + np.abs(phi)
            share = np.where(size < last, np.minimum(1.0, 2.0 * share), 0.5 * share)
            step = _newton_step(_convex(np.eye(3) + lam[:, None, None] * H), g, residual, phi)
            length = row_norms(step)
            x[active] = here + step * (share * np.minimum(1.0, longest / np.maximum(length, _TINY)))[:, None]
            left = (length > tolerance) | (share < 1.0)
            if not left.any():
                return x
            active, share, last = active[left], share[left], size[left]
        there = x[active]
        for _ in range(_SURFACE_STEPS):  # points near the medial axis have no unique closest point, but one on the surface
            phi, g, _ = self._field.derivatives(there)
            there = there - (phi / (g * g).sum(axis=1))[:, None] * g
        x[active] = there
        return x

    def _from_vertices(self, p: Array) -> Array:
        """Return the closest vertices of the mesh, (N, 3), m: starts of Newton's method."""
        _, index = self._tree.query(p)
        return np.array(self.vertices[index])


def _convex(A: Array) -> Array:
    """Return symmetric matrices (N, 3, 3) with the eigenvectors of A and positive eigenvalues: steps then descend."""
    minor = A - _LEAST_CURVATURE * np.eye(3)  # is positive definite where A needs no change: by Sylvester's criterion
    first, second = minor[:, 0, 0], minor[:, 0, 0] * minor[:, 1, 1] - minor[:, 0, 1] ** 2
    wrong = ~((first > 0.0) & (second > 0.0) & (np.linalg.det(minor) > 0.0))
    if wrong.any():
        values, vectors = np.linalg.eigh(A[wrong])
        A[wrong] = (vectors * np.maximum(np.abs(values), _LEAST_CURVATURE)[:, None, :]) @ vectors.swapaxes(1, 2)
    return A


def _newton_step(A: Array, g: Array, residual: Array, phi: Array) -> Array:
    """Return the steps (N, 3) of A dx + g dλ = residual, gᵀ dx = −φ."""
    rows = np.zeros((len(g), 4, 4))
    rows[:, :3, :3], rows[:, :3, 3], rows[:, 3, :3] = A, g, g
    right = np.concatenate([residual, -phi[:, None]], axis=1)
    return np.asarray(np.linalg.solve(rows, right[:, :, None])[:, :3, 0])


def _signed_volumes(corners: Array) -> Array:
    """Return the volumes (F,) of the tetrahedra between the faces (F, 3, 3) and the origin, m³."""
    return np.asarray((corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum(axis=1) / 6.0)


def _check_faces(value: object, count: int) -> Faces:
    """Return the faces as integers, checked."""
    given = arrays.check_array(value, "faces", (None, 3))
    if not 4 <= len(given) <= MAX_FACES:
        raise InvalidInput("faces", f"{len(given)} faces", f"from 4 to {MAX_FACES}")
    faces = given.astype(np.intp)
    for f in np.flatnonzero(((faces != given) | (faces < 0) | (faces >= count)).any(axis=1)):
        raise InvalidInput(f"faces[{f}]", given[f], f"three indices from 0 to {count - 1}")
    for f in np.flatnonzero((faces == np.roll(faces, 1, axis=1)).any(axis=1)):
        raise InvalidInput(f"faces[{f}]", faces[f], "three different vertices")
    faces.setflags(write=False)
    return faces


def _check_closed(faces: Faces) -> None:
    """Raise InvalidInput if an edge does not belong to exactly two faces that run through it in opposite directions."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    keys, counts = np.unique(edges, axis=0, return_counts=True)
    for edge in keys[counts > 1]:
        f = int(np.flatnonzero((edges == edge).all(axis=1))[1]) // 3
        raise InvalidInput(f"faces[{f}]", faces[f], f"a closed surface: another face has the edge {edge.tolist()} as well")
    present = {(int(i), int(j)) for i, j in keys}
    for i, j in keys.tolist():
        if (j, i) not in present:
            f = int(np.flatnonzero((edges == [i, j]).all(axis=1))[0]) // 3
            raise InvalidInput(f"faces[{f}]", faces[f], f"a closed surface: no other face has the edge {[i, j]}")
