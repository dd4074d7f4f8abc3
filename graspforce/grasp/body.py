"""The held object as a rigid body: its inertia, and the wrench of a motion by Newton–Euler.

`Body.wrench` is the reference of this law. Its other forms, and the tests that compare them with it:

- NumPy for many motions, `Body.wrenches`: tests/grasp/test_body_along.py
- C, `csrc/control/control_step.inc`: tests/control/test_compiled_step.py
- CasADi, `planning.free.object_equations`: tests/planning/test_reference_laws.py
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.constants import LARGEST_DISTANCE
from graspforce.core.errors import InvalidInput, MissingField
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.geometry import Shape, Solid
from graspforce.geometry.vectors import skew

_LEAST_MASS, _LARGEST_MASS = 1e-9, 1e6  # kg, of bodies in records
_LEAST_MOMENT, _LARGEST_MOMENT = 1e-20, 1e9  # kg·m²; a grain of sand has 1e-13


@dataclass(frozen=True, eq=False, slots=True)
class Body:
    """A rigid body with a frame O, which may be anywhere in the body.

    Args:
        mass: kg, > 0.
        inertia: (3, 3) about the centre of mass, in O's axes, kg·m². Symmetric; the principal moments are positive, and none
            is greater than the sum of the others.
        p_OM: (3,) centre of mass in O, m; zero by default.
        shape: its surface in O; None if it is not needed.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    mass: float
    inertia: Array
    p_OM: Array = field(default_factory=lambda: freeze(np.zeros(3)))
    shape: Shape | None = None

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self, mass: float, inertia: npt.ArrayLike, p_OM: npt.ArrayLike = ..., shape: Shape | None = None
        ) -> None: ...

    def __post_init__(self) -> None:
        set_fields(
            self,
            mass=arrays.check_number(self.mass, "mass", above=0.0),
            inertia=_check_inertia(self.inertia),
            p_OM=arrays.check_array(self.p_OM, "p_OM", (3,)),
        )

    def __str__(self) -> str:
        shape = "no shape" if self.shape is None else f"{type(self.shape).__name__.lower()}"
        moments = ", ".join(f"{moment:.3g}" for moment in np.linalg.eigvalsh(self.inertia))
        return f"Body: {self.mass:.4g} kg, {shape}, principal moments {moments} kg·m²"

    @classmethod
    def solid(cls, shape: Solid, mass: float) -> Body:
        """Return a body of uniform density.

        Args:
            shape: a sphere, cylinder, box, superquadric or mesh; its centre is the centre of mass.
            mass: kg, > 0.

        Raises:
            InvalidInput: the mass is not a finite number > 0, or the volume of the shape overflows or underflows.
        """
        try:
            _, unit = shape.inertia(1.0 / shape.volume)  # m², inertia per kilogram
        except (OverflowError, ZeroDivisionError):
            raise InvalidInput("shape", shape, "of a size that gives a finite volume above zero") from None
        return cls(mass, arrays.check_number(mass, "mass", above=0.0) * unit, shape.centre, shape)

    @classmethod
    def from_dict(cls, record: object, field: str = "body") -> Body:
        """Return the body of a record.

        Args:
            record: mapping with `mass` (kg, from 1e-9 to 1e6), and optional `inertia` (3 × 3, kg·m², about the centre of mass,
                principal moments from 1e-20 to 1e9), `centre_of_mass` (m, in O, at most 1e3 in each direction) and `shape`.
                Without `inertia`, the shape is required and the density is uniform.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=["mass"], optional=["inertia", "centre_of_mass", "shape"])
        given = {name: item for name, item in values.items() if item is not None}
        shape = Solid.from_dict(given["shape"], f"{field}.shape") if "shape" in given else None
        try:
            mass = arrays.check_number(values["mass"], "mass", above=0.0)
            arrays.check_number(mass, "mass", minimum=_LEAST_MASS, maximum=_LARGEST_MASS)
            if "inertia" in given:
                centre = given.get("centre_of_mass", (0.0, 0.0, 0.0))
                centre = arrays.check_array(centre, "centre_of_mass", (3,), limit=LARGEST_DISTANCE)
                inertia = arrays.check_array(given["inertia"], "inertia", (3, 3), limit=_LARGEST_MOMENT)
                return _check_moments(cls(mass, inertia, centre, shape), "inertia", inertia)
            if shape is None:
                raise MissingField("inertia", "required without a shape")
            if "centre_of_mass" in given:
                raise InvalidInput("centre_of_mass", given["centre_of_mass"], "absent without inertia")
            return _check_moments(cls.solid(shape, mass), "shape", shape)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> JsonRecord:
        """Return the record of the body.

        Raises:
            InvalidInput: the shape is an implicit surface, whose function cannot be saved or sent.
        """
        record = {"mass": self.mass, "inertia": self.inertia.tolist(), "centre_of_mass": self.p_OM.tolist()}
        return record if self.shape is None else {**record, "shape": self.shape.to_dict()}

    def wrench(self, motion: BodyMotion, gravity_H: npt.ArrayLike) -> Array:
        """Return the wrench that the contacts must supply for a motion, by Newton–Euler.

            force  = m (p̈_M − g),   p̈_M = p̈_O + ω̇ × c + ω × (ω × c),   c = p_OM
            moment = I ω̇ + ω × I ω + c × force

        Args:
            motion: pose, twist and acceleration of the body.
            gravity_H: (3,) acceleration of gravity in H, m/s².

        Returns:
            (6,) about O's origin, in O's axes, N and N·m.

        Raises:
            InvalidInput: `gravity_H` is not three finite numbers.
        """
        rates = np.concatenate([motion.acceleration, motion.twist[3:]]).reshape(3, 3)
        rates[0] -= arrays.check_array(gravity_H, "gravity_H", (3,))
        return freeze(self.wrench_unchecked(rates @ motion.R_HO))

    def wrench_unchecked(self, rates: Array) -> Array:
        """Return the wrench of `wrench` without checks, for inner loops.

        Scalar arithmetic: NumPy's overhead dominates for one motion.

        Args:
            rates: (3, 3) rows p̈_O − g, m/s², ω̇, rad/s², and ω, rad/s, in O's axes.

        Returns:
            (6,), N and N·m.
        """
        (ax, ay, az), (bx, by, bz), (ox, oy, oz) = rates.tolist()
        (tx, ty, tz), (lx, ly, lz) = (rates[1:] @ self.inertia).tolist()  # N·m and kg·m²/s: I ω̇ and I ω, I symmetric
        cx, cy, cz = self.p_OM.tolist()
        ux, uy, uz = oy * cz - oz * cy, oz * cx - ox * cz, ox * cy - oy * cx  # m/s: ω × c
        fx = self.mass * (ax + by * cz - bz * cy + oy * uz - oz * uy)  # N
        fy = self.mass * (ay + bz * cx - bx * cz + oz * ux - ox * uz)
        fz = self.mass * (az + bx * cy - by * cx + ox * uy - oy * ux)
        mx = tx + oy * lz - oz * ly + cy * fz - cz * fy  # N·m
        my = ty + oz * lx - ox * lz + cz * fx - cx * fz
        mz = tz + ox * ly - oy * lx + cx * fy - cy * fx
        return np.array([fx, fy, fz, mx, my, mz])

    def wrenches(self, p_dd: Array, omega: Array, alpha: Array) -> Array:
        """Return the wrenches of M motions. All arguments are in O's axes and unchecked.

        Args:
            p_dd: (M, 3) acceleration of O's origin minus gravity, m/s².
            omega: (M, 3) angular velocity, rad/s.
            alpha: (M, 3) angular acceleration, rad/s².

        Returns:
            (M, 6) about O's origin, in O's axes, N and N·m.
        """
        c = np.broadcast_to(self.p_OM, omega.shape)
        force = self.mass * (p_dd + np.cross(alpha, c) + np.cross(omega, np.cross(omega, c)))  # N
        moment = alpha @ self.inertia + np.cross(omega, omega @ self.inertia) + np.cross(c, force)  # N·m
        return np.hstack([force, moment])

    def mass_matrix(self) -> Array:
        """Return M_o = [m 1, −m ĉ; m ĉ, I − m ĉ ĉ], with c = p_OM and ĉ x = c × x.

        M_o maps the acceleration of O's origin and the angular acceleration, from rest, to the wrench about O's origin.

        Returns:
            (6, 6) in O's axes; kg, kg·m and kg·m².
        """
        c_hat = skew(self.p_OM)
        top = np.hstack([self.mass * np.eye(3), -self.mass * c_hat])
        return freeze(np.vstack([top, np.hstack([self.mass * c_hat, self.inertia - self.mass * c_hat @ c_hat])]))

    def mass_matrix_factor(self) -> Array:
        """Return a factor L of M_o = L Lᵀ, L = [√m 1, 0; √m ĉ, L_I] with L_I L_Iᵀ = I.

        L exists also for a body far from O, whose M_o is not positive definite in floating-point numbers.

        Returns:
            (6, 6) lower triangular by blocks; √kg and √kg·m.
        """
        top = np.hstack([np.sqrt(self.mass) * np.eye(3), np.zeros((3, 3))])
        return freeze(np.vstack([top, np.hstack([skew(np.sqrt(self.mass) * self.p_OM), np.linalg.cholesky(self.inertia)])]))


def _check_moments(body: Body, field: str, value: object) -> Body:
    """Return the body if its principal moments are those of a body that a hand can hold."""
    moments = np.linalg.eigvalsh(body.inertia)
    if not _LEAST_MOMENT <= moments[0] <= moments[2] <= _LARGEST_MOMENT:
        allowed = f"of principal moments from {_LEAST_MOMENT:g} to {_LARGEST_MOMENT:g} kg·m²"
        raise InvalidInput(field, value, allowed)
    return body


def _check_inertia(value: object) -> Array:
    """Return an inertia that a body can have."""
    inertia = arrays.check_array(value, "inertia", (3, 3))
    moments = np.linalg.eigvalsh(inertia)
    rounding = 1e-9 * np.abs(moments).max()  # of the digits in a file
    if np.abs(inertia - inertia.T).max() > rounding:
        raise InvalidInput("inertia", value, "symmetric")
    if not _is_positive_definite(inertia) or moments[0] <= 0.0 or moments[2] > moments[0] + moments[1] + rounding:
        allowed = "of principal moments that are positive, none greater than the sum of the other two"
        raise InvalidInput("inertia", moments, allowed)
    return inertia


def _is_positive_definite(matrix: Array) -> bool:
    """Return whether a symmetric matrix has a Cholesky factor."""
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True
