"""Shapes of objects: where a finger touches one, which way is in, and how the surface bends.

Every shape stands in its own frame O at its centre and obeys one law. Its level function φ is negative inside and zero on the
surface, and there

    n = −∇φ/‖∇φ‖                  the inward normal: 001 (12), with the sign that points into the object,
    S = Tᵀ (∂²φ/∂x²) T/‖∇φ‖       the shape operator on a tangent basis T (3, 2): its eigenvalues are the principal curvatures.

Points are p_O, (3,) or (N, 3), in O, m; answers come in the same shape. A point belongs to the surface when it is within
`SURFACE_TOLERANCE` times the shape's size of it: coordinates that went through a file or a finger's kinematics carry about
that error.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput

SURFACE_TOLERANCE = 1e-6  # of the size: how far from the surface, or from an edge, still counts as on it


class Shape(ABC):
    """What every shape answers: φ, inward normal, nearest point, curvatures."""

    _places_without_normal: ClassVar[str]  # where this shape has no normal, in words

    @property
    @abstractmethod
    def _largest_half_extent(self) -> float:
        """The largest half-extent, m: tolerances are relative to it."""

    @abstractmethod
    def _phi(self, p: Array) -> Array:
        """(N,) φ."""

    @abstractmethod
    def _gradient(self, p: Array) -> Array:
        """(N, 3) ∇φ; zero where there is no single normal."""

    @abstractmethod
    def _hessian(self, p: Array) -> Array:
        """(N, 3, 3) ∂²φ/∂x²; not finite where there is none. Asked only where there is a normal."""

    @abstractmethod
    def closest_points(self, p: Array) -> Array:
        """(N, 3) `project_to_surface` of (N, 3) points that nobody checks: for inner loops, whose numbers are right already."""

    @property
    def primitive_parameters(self) -> tuple[int, float, float, float] | None:
        """Kind and sizes by which compiled code (`closest_points.h`) knows a shape whose feet have a closed form; None for others."""
        return None

    def phi(self, p_O: Any) -> Array:
        """φ, negative inside: the signed distance in m for sphere, cylinder and box, the user's own for an implicit surface.

        Args:
            p_O: (3,) or (N, 3) points in O, m.

        Returns:
            () or (N,).
        """
        p, rows = _as_rows(p_O)
        return arrays.freeze(self._phi(p).reshape(rows))

    def inward_normal(self, p_O: Any) -> Array:
        """The unit normal into the object, n = −∇φ/‖∇φ‖.

        Args:
            p_O: (3,) or (N, 3) points of the surface in O, m.

        Returns:
            (3,) or (N, 3) in O.

        Raises:
            InvalidInput: a point that is off the surface, which says by how much, or where the surface has no normal.
        """
        p, rows = _as_rows(p_O)
        gradient = self._surface_gradient(p, rows)
        return arrays.freeze((-gradient / row_norms(gradient)[:, None]).reshape(*rows, 3))

    def project_to_surface(self, p_O: Any) -> Array:
        """The point of the surface that is nearest; where several are equally near, one of them.

        Args:
            p_O: (3,) or (N, 3) points in O, m, inside or outside.

        Returns:
            (3,) or (N, 3) points of the surface in O, m.
        """
        p, rows = _as_rows(p_O)
        return arrays.freeze(self.closest_points(p).reshape(*rows, 3))

    def curvatures(self, p_O: Any) -> Array:
        """The principal curvatures k1 ≥ k2, 1/m, positive where convex: the eigenvalues of S = Tᵀ (∂²φ/∂x²) T/‖∇φ‖.

        Args:
            p_O: (3,) or (N, 3) points of the surface in O, m.

        Returns:
            (2,) or (N, 2).

        Raises:
            InvalidInput: as `inward_normal`, and where the curvature is infinite or not defined.
        """
        p, rows = _as_rows(p_O)
        gradient = self._surface_gradient(p, rows)
        steepness = row_norms(gradient)
        T = tangent_bases(gradient / steepness[:, None])
        with np.errstate(invalid="ignore"):  # ∞ − ∞ where the curvature is infinite, refused next
            S = T.transpose(0, 2, 1) @ self._hessian(p) @ T / steepness[:, None, None]
        for i in np.flatnonzero(~np.isfinite(S).all(axis=(1, 2))):
            raise InvalidInput(_field_path(i, rows), p[i], "where the surface has a finite curvature")
        return arrays.freeze(np.linalg.eigvalsh(S)[:, ::-1].reshape(*rows, 2))

    def _surface_gradient(self, p: Array, rows: tuple[int, ...]) -> Array:
        """∇φ at points that must be on the surface, where it has a normal."""
        gradient = self._gradient(p)
        steepness = row_norms(gradient)
        for i in np.flatnonzero(steepness == 0.0):
            raise InvalidInput(_field_path(i, rows), p[i], f"where the surface has a normal: not {self._places_without_normal}")
        off = np.abs(self._phi(p)) / steepness  # m, to first order
        for i in np.flatnonzero(off > SURFACE_TOLERANCE * self._largest_half_extent):
            allowed = (
                f"on the surface to within {SURFACE_TOLERANCE * self._largest_half_extent:.3g} m: it is {off[i]:.3g} m off"
            )
            raise InvalidInput(_field_path(i, rows), p[i], allowed)
        return gradient


class Solid(Shape):
    """A shape whose volume and inertia have a closed form, and whose axes are its principal axes."""

    @property
    @abstractmethod
    def volume(self) -> float:
        """m³."""

    @property
    @abstractmethod
    def _mean_squares(self) -> Array:
        """(3,) the mean of x², y² and z² over the volume, m²."""

    def inertia(self, density: float) -> tuple[float, Array]:
        """Mass m = ρV and inertia about the centre, I = m (tr D · 1 − D) with D = diag(mean x², y², z²).

        Args:
            density: ρ, kg/m³, > 0.

        Returns:
            mass in kg, and I_O (3, 3) in kg·m² in O.
        """
        mass = arrays.check_number(density, "density", above=0.0) * self.volume  # kg
        return mass, arrays.freeze(mass * np.diag(self._mean_squares.sum() - self._mean_squares))


def _as_rows(p_O: Any) -> tuple[Array, tuple[int, ...]]:
    """Points as (N, 3), and the leading shape of the answer: () for one point, (N,) for many."""
    try:
        many = np.ndim(p_O) == 2
    except ValueError:  # ragged: refused below
        many = True
    if many:
        p = arrays.check_array(p_O, "p_O", (None, 3))
        return p, (len(p),)
    return arrays.check_array(p_O, "p_O", (3,))[None], ()


def _field_path(i: np.intp, rows: tuple[int, ...]) -> str:
    return f"p_O[{i}]" if rows else "p_O"


def check_positive(value: Any, field: str) -> Array:
    result = arrays.check_array(value, field, (3,))
    for i in np.flatnonzero(result <= 0.0):
        raise InvalidInput(f"{field}[{i}]", float(result[i]), "a finite number > 0")
    return result


def row_norms(v: Array) -> Array:
    """(N,) lengths of (N, 3) vectors, without overflow."""
    return np.hypot(np.hypot(v[:, 0], v[:, 1]), v[:, 2])


def unit_vectors(v: Array, fallback: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
    """(N, 3) unit vectors; ``otherwise`` for the zero vector."""
    norm = row_norms(v)[:, None]
    if np.count_nonzero(norm) == len(norm):
        return np.asarray(v / norm)
    return np.asarray(np.divide(v, norm, out=np.broadcast_to(fallback, v.shape).copy(), where=norm > 0))


def tangent_bases(n: Array) -> Array:
    """(N, 3, 2) orthonormal bases of the planes across unit vectors n (N, 3)."""
    axis = np.eye(3)[np.abs(n).argmin(axis=1)]
    t = unit_vectors(np.cross(n, axis))
    return np.stack([t, np.cross(n, t)], axis=-1)
