"""Any smooth object, as the surface where a function is zero."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.geometry.shape import SURFACE_TOLERANCE, Shape
from graspforce.geometry.vectors import row_norms, tangent_bases


@dataclass(frozen=True, eq=False, slots=True)
class ImplicitSurface(Shape):
    """The surface where a function of the user's is zero: any smooth object.

    Args:
        value: φ, from a point (3,) in O, m, to a number, negative inside.
        gradient: ∇φ, from a point (3,) to (3,).
        size: the object's largest half-extent, m, > 0: tolerances and difference steps are relative to it.

    Its curvatures come from central differences of ∇φ: on an ellipsoid they are right to 1e-7 of their value.
    """

    value: Callable[[Array], float]
    gradient: Callable[[Array], Any]
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
        step = np.cbrt(np.finfo(float).eps) * self.size  # m: rounding and truncation of a central difference alike
        columns = [self._gradient(p + step * axis) - self._gradient(p - step * axis) for axis in np.eye(3)]
        H = np.stack(columns, axis=-1) / (2.0 * step)
        return np.asarray(0.5 * (H + H.transpose(0, 2, 1)))

    def closest_points(self, p: Array) -> Array:
        return np.array([self._closest_point(point) for point in p]).reshape(p.shape)

    def _closest_point(self, p: Array) -> Array:
        """The nearest point that descent reaches from p: the nearest one where p is within the surface's radii of curvature.

        Newton's method for ½‖x − p‖² on the surface, whose Hessian on the tangent plane is 1 + d S with d the height of p
        above it, each step pulled back along ∇φ and halved until it comes nearer.
        """
        x = self._move_to_surface(p)
        for _ in range(100):
            gradient = self._gradient(x[None])
            T = tangent_bases(gradient / row_norms(gradient)[:, None])[0]
            aside = T.T @ (p - x)  # m: zero at a foot of the perpendicular
            if math.hypot(*aside) <= 1e-12 * self.size:
                return x
            lift = (p - x) @ gradient[0] / (gradient[0] @ gradient[0])  # d/‖∇φ‖
            A = np.eye(2) + lift * T.T @ self._hessian(x[None])[0] @ T
            step = T @ (np.linalg.solve(A, aside) if np.linalg.eigvalsh(A)[0] > 1e-3 else aside)
            for halving in 0.5 ** np.arange(50):
                nearer = self._move_to_surface(x + halving * step)
                if math.dist(nearer, p) < math.dist(x, p):
                    break
            else:
                return x  # no step comes nearer: x is the foot to rounding
            x = nearer
        return x

    def _move_to_surface(self, x: Array) -> Array:
        """A point of the surface, by Newton steps along ∇φ; each is at most a size long and halved until |φ| falls."""
        phi = self._phi(x[None])[0]
        for _ in range(100):
            gradient = self._gradient(x[None])[0]
            slope = math.hypot(*gradient)
            if slope == 0.0:
                raise InvalidInput("p_O", x, f"where a way to the surface is known: not {self._places_without_normal}")
            if abs(phi) <= 1e-14 * slope * self.size:
                return x
            reach = min(abs(phi) / slope, self.size)  # m
            for halving in 0.5 ** np.arange(50):
                there = x - halving * math.copysign(reach, phi) * gradient / slope
                level = self._phi(there[None])[0]
                if abs(level) < abs(phi):
                    break
            else:
                break
            x, phi = there, level
        if abs(phi) > SURFACE_TOLERANCE * slope * self.size:
            raise InvalidInput("p_O", x, "where ∇φ leads to the surface")
        return x
