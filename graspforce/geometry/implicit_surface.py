"""Implicit surface: any smooth object, given as the zero set of a function."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.geometry.shape import SURFACE_TOLERANCE, Shape
from graspforce.geometry.vectors import row_norms, tangent_bases

_MAX_STEPS = 100  # of Newton's method
_HALVINGS = 0.5 ** np.arange(50)  # step lengths of the line search


@dataclass(frozen=True, eq=False, slots=True)
class ImplicitSurface(Shape):
    """Surface where a function φ of the user is zero.

    Curvatures are computed by central differences of ∇φ; on an ellipsoid their relative error is 1e-7.

    Args:
        value: φ, from a point (3,) in O, m, to a number; negative inside.
        gradient: ∇φ, from a point (3,) in O, m, to (3,).
        size: largest half-extent of the object, m, > 0; tolerances and difference steps are relative to it.

    Raises:
        InvalidInput: the size is not a positive number.
    """

    value: Callable[[Array], float]
    gradient: Callable[[Array], npt.ArrayLike]
    size: float
    _places_without_normal: ClassVar[str] = "where ∇φ vanishes"

    def __post_init__(self) -> None:
        set_fields(self, size=arrays.check_number(self.size, "size", above=0.0))

    @property
    def _largest_half_extent(self) -> float:
        return self.size

    def _phi(self, p: Array) -> Array:
        return np.array([arrays.check_number(self.value(point), "value(p_O)") for point in p])

    def _gradient(self, p: Array) -> Array:
        return np.array([arrays.check_array(self.gradient(point), "gradient(p_O)", (3,)) for point in p]).reshape(p.shape)

    def _hessian(self, p: Array) -> Array:
        step = np.cbrt(np.finfo(float).eps) * self.size  # m; balances rounding and truncation of a central difference
        columns = [self._gradient(p + step * axis) - self._gradient(p - step * axis) for axis in np.eye(3)]
        H = np.stack(columns, axis=-1) / (2.0 * step)
        return np.asarray(0.5 * (H + H.transpose(0, 2, 1)))

    def closest_points(self, p: Array) -> Array:
        return np.array([self._closest_point(point) for point in p]).reshape(p.shape)

    def _closest_point(self, p: Array) -> Array:
        """Return a local minimum of the distance from p. It is the closest point if p is within the radii of curvature.

        Newton's method minimises ½‖x − p‖² on the surface. Its Hessian on the tangent plane is 1 + d S, with d the height of p
        above that plane. Each step is moved back to the surface along ∇φ, and halved until the distance decreases.
        """
        x = self._move_to_surface(p)
        for _ in range(_MAX_STEPS):
            gradient = self._gradient(x[None])
            T = tangent_bases(gradient / row_norms(gradient)[:, None])[0]
            tangential = T.T @ (p - x)  # m; zero at a closest point
            if math.hypot(*tangential) <= 1e-12 * self.size:
                return x
            height = (p - x) @ gradient[0] / (gradient[0] @ gradient[0])  # d/‖∇φ‖
            A = np.eye(2) + height * T.T @ self._hessian(x[None])[0] @ T
            step = T @ (np.linalg.solve(A, tangential) if np.linalg.eigvalsh(A)[0] > 1e-3 else tangential)
            for halving in _HALVINGS:
                candidate = self._move_to_surface(x + halving * step)
                if math.dist(candidate, p) < math.dist(x, p):
                    break
            else:
                return x  # no step decreases the distance: converged to rounding
            x = candidate
        return x

    def _move_to_surface(self, x: Array) -> Array:
        """Return a point of the surface by Newton steps along ∇φ, at most `size` long and halved until |φ| decreases."""
        phi = self._phi(x[None])[0]
        for _ in range(_MAX_STEPS):
            gradient = self._gradient(x[None])[0]
            slope = math.hypot(*gradient)
            if slope == 0.0:
                raise InvalidInput("p_O", x, f"where ∇φ points to the surface: not {self._places_without_normal}")
            if abs(phi) <= 1e-14 * slope * self.size:
                return x
            length = min(abs(phi) / slope, self.size)  # m
            for halving in _HALVINGS:
                candidate = x - halving * math.copysign(length, phi) * gradient / slope
                level = self._phi(candidate[None])[0]
                if abs(level) < abs(phi):
                    break
            else:
                break
            x, phi = candidate, level
        if abs(phi) > SURFACE_TOLERANCE * slope * self.size:
            raise InvalidInput("p_O", x, "where ∇φ points to the surface")
        return x
