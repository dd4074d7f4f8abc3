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

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry.vectors import row_norms, tangent_bases

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

    def to_dict(self) -> dict[str, Any]:
        """Return the shape's record: its `type` and sizes. Only a `Solid` has one.

        Raises:
            InvalidInput: the surface is a function, which cannot be saved or sent.
        """
        raise InvalidInput("shape", type(self).__name__, f"one of {', '.join(Solid.types)}: a function cannot be saved or sent")

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
    """A shape whose volume and inertia have a closed form, and whose axes are its principal axes.

    Every solid is a dataclass: its record holds the fields of the constructor, and `type`, the class's name in lower case.
    """

    types: ClassVar[dict[str, type[Solid]]] = {}  # of the records

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        Solid.types[cls.__name__.lower()] = cls

    @property
    @abstractmethod
    def volume(self) -> float:
        """m³."""

    @property
    @abstractmethod
    def _mean_squares(self) -> Array:
        """(3,) the mean of x², y² and z² over the volume, m²."""

    def to_dict(self) -> dict[str, Any]:
        """Return the shape's record: its `type` and sizes."""
        sizes = {name: getattr(self, name) for name in self._record_fields()}
        plain = {name: size.tolist() if isinstance(size, np.ndarray) else size for name, size in sizes.items()}
        return {"type": type(self).__name__.lower(), **plain}

    @classmethod
    def from_dict(cls, record: object, field: str = "shape") -> Solid:
        """Return the sphere, cylinder, box or superquadric of a record.

        Args:
            record: mapping with `type` and the sizes by the names of the constructor's arguments.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        if not isinstance(record, Mapping) or "type" not in record:
            raise InvalidInput(f"{field}.type", None, "one of " + ", ".join(Solid.types))
        solid = Solid.types[fields.check_choice(record["type"], f"{field}.type", Solid.types)]
        names = solid._record_fields()
        values = fields.check_record(record, field, required=["type", *names])
        try:
            return solid(**{name: values[name] for name in names})
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    @classmethod
    def _record_fields(cls) -> list[str]:
        """Return the names of the constructor's arguments."""
        return [each.name for each in dataclasses.fields(cls) if each.init]  # type: ignore[arg-type]  # every solid is one

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
        raise InvalidInput(f"{field}[{i}]", float(result[i]), "greater than 0")
    return result
