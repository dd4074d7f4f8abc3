"""Interface of all shapes: level function, inward normal, closest point, curvatures, and volume of solids.

A shape is given in its own frame O, with the origin at its centre. Its level function φ is negative inside and zero on the
surface, where

    n = −∇φ/‖∇φ‖                  is the inward normal; Al-Gallaf (undated), eq. (12), with the sign that points inwards,
    S = Tᵀ (∂²φ/∂x²) T/‖∇φ‖       is the shape operator on a tangent basis T (3, 2); its eigenvalues are the curvatures.

Points are p_O, (3,) or (N, 3), in O, m. A point counts as on the surface if its distance is at most `SURFACE_TOLERANCE` times
the shape's largest half-extent. Coordinates from files or forward kinematics carry about that error.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.constants import LARGEST_DISTANCE
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.geometry.vectors import row_norms, tangent_bases

SurfaceParameters = tuple[str, float, float, float] | tuple[str, float, float, float, float, float]
SURFACE_TOLERANCE = 1e-6  # distance from the surface, or from an edge, that counts as zero; relative to the half-extent
_LEAST_SIZE = 1e-6  # m, of a shape in a record


class Shape(ABC):
    """Surface of an object.

    A subclass implements φ with its first two derivatives, and `closest_points`.
    """

    _places_without_normal: ClassVar[str]  # where the surface has no normal, for error messages

    @property
    @abstractmethod
    def _largest_half_extent(self) -> float:
        """Largest half-extent, m; tolerances are relative to it."""

    @abstractmethod
    def _phi(self, p: Array) -> Array:
        """Return φ (N,) at points (N, 3)."""

    @abstractmethod
    def _gradient(self, p: Array) -> Array:
        """Return ∇φ (N, 3) at points (N, 3); zero where the surface has no unique normal."""

    @abstractmethod
    def _hessian(self, p: Array) -> Array:
        """Return ∂²φ/∂x² (N, 3, 3) at points with a normal; not finite where it does not exist."""

    @abstractmethod
    def closest_points(self, p: Array) -> Array:
        """Return the closest points of the surface, as `project_to_surface` but without checks, for inner loops.

        Args:
            p: (N, 3) points in O, m.

        Returns:
            (N, 3) in O, m.
        """

    @property
    def primitive_parameters(self) -> SurfaceParameters | None:
        """Kind and sizes of a shape that compiled code supports (`csrc/control/closest_point.inc`); None for other shapes.

        A superquadric adds its exponents.
        """
        return None

    def to_dict(self) -> JsonRecord:
        """Return the shape's record: its `type` and sizes. Only a `Solid` has one.

        Raises:
            InvalidInput: the shape is an implicit surface, whose function cannot be saved or sent.
        """
        raise InvalidInput("shape", type(self).__name__, f"one of {', '.join(Solid.types)}: a function cannot be saved or sent")

    def phi(self, p_O: npt.ArrayLike) -> Array:
        """Return the level function φ, which is negative inside.

        For a sphere, cylinder and box it is the signed distance in m; for an implicit surface it is the given function.

        Args:
            p_O: (3,) or (N, 3) points in O, m.

        Returns:
            () or (N,).

        Raises:
            InvalidInput: not finite numbers of such a shape.
        """
        p, rows = _as_rows(p_O)
        return arrays.freeze(self._phi(p).reshape(rows))

    def inward_normal(self, p_O: npt.ArrayLike) -> Array:
        """Return the unit normals into the object, n = −∇φ/‖∇φ‖.

        Args:
            p_O: (3,) or (N, 3) points on the surface in O, m.

        Returns:
            (3,) or (N, 3) in O.

        Raises:
            InvalidInput: a point is not on the surface, with its distance, or the surface has no normal there.
        """
        p, rows = _as_rows(p_O)
        gradient = self._surface_gradient(p, rows)
        return arrays.freeze((-gradient / row_norms(gradient)[:, None]).reshape(*rows, 3))

    def project_to_surface(self, p_O: npt.ArrayLike) -> Array:
        """Return the closest points of the surface. If several are equally close, return one of them.

        Args:
            p_O: (3,) or (N, 3) points in O, m, inside or outside.

        Returns:
            (3,) or (N, 3) points on the surface in O, m.

        Raises:
            InvalidInput: not finite numbers of such a shape, or no closest point of an implicit surface was found.
        """
        p, rows = _as_rows(p_O)
        return arrays.freeze(self.closest_points(p).reshape(*rows, 3))

    def signed_distance(self, p_O: npt.ArrayLike) -> Array:
        """Return the distances from the surface, negative inside.

        Args:
            p_O: (3,) or (N, 3) points in O, m.

        Returns:
            () or (N,), m.

        Raises:
            InvalidInput: as in `project_to_surface`.
        """
        p, rows = _as_rows(p_O)
        distances = row_norms(p - self.closest_points(p))  # m
        return arrays.freeze(np.copysign(distances, self._phi(p)).reshape(rows))

    def curvatures(self, p_O: npt.ArrayLike) -> Array:
        """Return the principal curvatures k1 ≥ k2, positive where convex: the eigenvalues of S = Tᵀ (∂²φ/∂x²) T/‖∇φ‖.

        Args:
            p_O: (3,) or (N, 3) points on the surface in O, m.

        Returns:
            (2,) or (N, 2), 1/m.

        Raises:
            InvalidInput: as in `inward_normal`, and where the curvature is infinite or undefined.
        """
        p, rows = _as_rows(p_O)
        gradient = self._surface_gradient(p, rows)
        steepness = row_norms(gradient)
        T = tangent_bases(gradient / steepness[:, None])
        with np.errstate(invalid="ignore"):  # ∞ − ∞ at infinite curvature, which is rejected below
            S = T.transpose(0, 2, 1) @ self._hessian(p) @ T / steepness[:, None, None]
        for i in np.flatnonzero(~np.isfinite(S).all(axis=(1, 2))):
            raise InvalidInput(_field_path(i, rows), p[i], "where the surface has a finite curvature")
        return arrays.freeze(np.linalg.eigvalsh(S)[:, ::-1].reshape(*rows, 2))

    def _surface_gradient(self, p: Array, rows: tuple[int, ...]) -> Array:
        """Return ∇φ at points on the surface. Raise InvalidInput for a point off the surface or without a normal."""
        gradient = self._gradient(p)
        steepness = row_norms(gradient)
        for i in np.flatnonzero(steepness == 0.0):
            raise InvalidInput(_field_path(i, rows), p[i], f"where the surface has a normal: not {self._places_without_normal}")
        distance = np.abs(self._phi(p)) / steepness  # m, to first order
        tolerance = SURFACE_TOLERANCE * self._largest_half_extent  # m
        for i in np.flatnonzero(distance > tolerance):
            allowed = f"on the surface to within {tolerance:.3g} m: it is {distance[i]:.3g} m off"
            raise InvalidInput(_field_path(i, rows), p[i], allowed)
        return gradient


class Solid(Shape):
    """Shape with a volume and an inertia.

    Every solid is a dataclass. Its record holds `type`, its `type_name`, and the constructor's arguments.
    """

    type_name: ClassVar[str]  # by default the class name in lower case
    types: ClassVar[dict[str, type[Solid]]] = {}  # by the `type` of their records

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "type_name" not in cls.__dict__:
            cls.type_name = cls.__name__.lower()
        Solid.types[cls.type_name] = cls

    @property
    @abstractmethod
    def volume(self) -> float:
        """Volume, m³."""

    @property
    def centre(self) -> Array:
        """(3,) centre of the volume in O, m."""
        return arrays.freeze(np.zeros(3))

    @property
    @abstractmethod
    def _mean_products(self) -> Array:
        """(3, 3) means of x xᵀ over the volume, with x from its centre, m²."""

    def to_dict(self) -> JsonRecord:
        """Return the shape's record: its `type` and sizes."""
        sizes = {name: getattr(self, name) for name in self._record_fields()}
        plain = {name: size.tolist() if isinstance(size, np.ndarray) else size for name, size in sizes.items()}
        return {"type": self.type_name, **plain}

    @classmethod
    def from_dict(cls, record: object, field: str = "shape") -> Solid:
        """Return the sphere, cylinder, box, superquadric or mesh of a record.

        Args:
            record: mapping with `type` and the sizes by the names of the constructor's arguments. The largest half-extent is
                from 1e-6 to 1e3 m.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        if not isinstance(record, Mapping) or "type" not in record:
            raise InvalidInput(f"{field}.type", None, "one of " + ", ".join(Solid.types))
        solid = Solid.types[fields.check_choice(record["type"], f"{field}.type", Solid.types)]
        names = solid._record_fields()
        defaults = [each.name for each in dataclasses.fields(solid) if each.default is not dataclasses.MISSING]  # type: ignore[arg-type]
        required = [name for name in names if name not in defaults]
        values = fields.check_record(record, field, required=["type", *required], optional=defaults)
        try:
            shape = solid(**{name: values[name] for name in names if name in values})
        except InvalidInput as error:
            raise error.with_prefix(field) from None
        if not _LEAST_SIZE <= shape._largest_half_extent <= LARGEST_DISTANCE:
            raise InvalidInput(field, record, f"of a size with half-extents from {_LEAST_SIZE:g} to {LARGEST_DISTANCE:g} m")
        return shape

    @classmethod
    def _record_fields(cls) -> list[str]:
        """Return the names of the constructor's arguments."""
        return [each.name for each in dataclasses.fields(cls) if each.init]  # type: ignore[arg-type]  # a dataclass

    def inertia(self, density: float) -> tuple[float, Array]:
        """Return mass and inertia for a uniform density: m = ρV, I = m (tr D · 1 − D) with D the means of x xᵀ.

        Args:
            density: ρ, kg/m³, > 0.

        Returns:
            The mass in kg, and the inertia (3, 3) about the centre of mass in O's axes, kg·m².

        Raises:
            InvalidInput: the density is not a positive number.
        """
        mass = arrays.check_number(density, "density", above=0.0) * self.volume  # kg
        D = self._mean_products
        return mass, arrays.freeze(mass * (np.trace(D) * np.eye(3) - D))


def _as_rows(p_O: npt.ArrayLike) -> tuple[Array, tuple[int, ...]]:
    """Return points as (N, 3), and the leading shape of the result: () for one point, (N,) for several."""
    try:
        is_array_of_points = np.ndim(p_O) == 2
    except ValueError:  # ragged; rejected below
        is_array_of_points = True
    if is_array_of_points:
        p = arrays.check_array(p_O, "p_O", (None, 3))
        return p, (len(p),)
    return arrays.check_array(p_O, "p_O", (3,))[None], ()


def _field_path(i: np.intp, rows: tuple[int, ...]) -> str:
    """Return the path of point i for error messages."""
    return f"p_O[{i}]" if rows else "p_O"
