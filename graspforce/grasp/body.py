"""The held object as a rigid body: its inertia, its motion, and the wrench that moves it so."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, MissingField
from graspforce.geometry import Shape, Solid


@dataclass(frozen=True, eq=False, slots=True)
class Body:
    """A rigid body. Its frame O may stand anywhere in it.

    Args:
        mass: kg, > 0.
        inertia: (3, 3) about the centre of mass, in O's axes, kg·m²; symmetric, with principal moments that a real body can
            have: positive, none greater than the sum of the other two.
        p_OM: (3,) the centre of mass in O, m; O's origin by default.
        shape: its surface in O, where contacts can be; None where nobody asks for it.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    mass: float
    inertia: Array
    p_OM: Array = field(default_factory=lambda: freeze(np.zeros(3)))
    shape: Shape | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", arrays.check_number(self.mass, "mass", above=0.0))
        object.__setattr__(self, "inertia", _inertia(self.inertia))
        object.__setattr__(self, "p_OM", arrays.check_array(self.p_OM, "p_OM", (3,)))

    @classmethod
    def solid(cls, shape: Solid, mass: float) -> Body:
        """A body of one material throughout, whose mass is known.

        Args:
            shape: its surface: a sphere, cylinder, box or superquadric.
            mass: kg.
        """
        _, unit = shape.inertia(1.0 / shape.volume)  # m², of one kilogram
        return cls(mass, arrays.check_number(mass, "mass", above=0.0) * unit, shape=shape)

    @classmethod
    def from_dict(cls, record: object, field: str = "body") -> Body:
        """Return the body of a record.

        Args:
            record: mapping with `mass` (kg), and optional `inertia` (3 × 3, kg·m², about the centre of mass),
                `centre_of_mass` (m, in O) and `shape`. Without `inertia`, the shape is required and the density is uniform.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=["mass"], optional=["inertia", "centre_of_mass", "shape"])
        given = {name: item for name, item in values.items() if item is not None}
        shape = Solid.from_dict(given["shape"], f"{field}.shape") if "shape" in given else None
        try:
            if "inertia" in given:
                centre = arrays.check_array(given.get("centre_of_mass", (0.0, 0.0, 0.0)), "centre_of_mass", (3,))
                return cls(values["mass"], given["inertia"], centre, shape)
            if shape is None:
                raise MissingField("inertia", "required without a shape")
            if "centre_of_mass" in given:
                raise InvalidInput("centre_of_mass", given["centre_of_mass"], "absent without inertia")
            return cls.solid(shape, values["mass"])
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> dict[str, Any]:
        """Return the record of the body.

        Raises:
            InvalidInput: the shape is an implicit surface, whose function cannot be saved or sent.
        """
        record = {"mass": self.mass, "inertia": self.inertia.tolist(), "centre_of_mass": self.p_OM.tolist()}
        return record if self.shape is None else {**record, "shape": self.shape.to_dict()}

    def wrench(self, motion: BodyMotion, gravity_H: Any) -> Array:
        """The wrench that all contacts together must supply so that the body moves as said: Newton's and Euler's laws.

            force  = m (p̈_M − g),   p̈_M = p̈_O + ω̇ × c + ω × (ω × c),   c = p_OM
            moment = I ω̇ + ω × I ω + c × force

        Args:
            motion: its pose, twist and acceleration.
            gravity_H: (3,) the acceleration of gravity in H, m/s².

        Returns:
            (6,) about O's origin, in O's axes, N and N·m.
        """
        rates = np.concatenate([motion.acceleration, motion.twist[3:]]).reshape(3, 3)
        rates[0] -= arrays.check_array(gravity_H, "gravity_H", (3,))
        return freeze(self.wrench_unchecked(rates @ motion.R_HO))

    def wrench_unchecked(self, rates: Array) -> Array:
        """(6,) `wrench` for inner loops: rates (3, 3) are p̈_O − g, ω̇ and ω in O's axes, by rows; nobody checks them."""
        (ax, ay, az), (bx, by, bz), (ox, oy, oz) = rates.tolist()  # by components: half of the time that lists of them take
        (tx, ty, tz), (lx, ly, lz) = (rates[1:] @ self.inertia).tolist()  # N·m and kg·m²/s: I ω̇ and I ω, I being symmetric
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
        """`wrench` of M motions at once, all in O's axes.

        Args:
            p_dd: (M, 3) the acceleration of O's origin less that of gravity, m/s².
            omega, alpha: (M, 3) angular velocity, rad/s, and acceleration, rad/s².

        Returns:
            (M, 6), N and N·m.
        """
        c = np.broadcast_to(self.p_OM, omega.shape)
        force = self.mass * (p_dd + np.cross(alpha, c) + np.cross(omega, np.cross(omega, c)))  # N
        moment = alpha @ self.inertia + np.cross(omega, omega @ self.inertia) + np.cross(c, force)  # N·m
        return np.hstack([force, moment])

    def mass_matrix(self) -> Array:
        """(6, 6) M_o: the wrench about O, in O's axes, per acceleration of O's origin and angular acceleration, from rest.

        M_o = [m 1, −m ĉ; m ĉ, I − m ĉ ĉ], kg, kg·m and kg·m², ĉ the matrix with ĉ x = c × x.
        """
        x, y, z = self.p_OM
        c_hat = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        top = np.hstack([self.mass * np.eye(3), -self.mass * c_hat])
        return freeze(np.vstack([top, np.hstack([self.mass * c_hat, self.inertia - self.mass * c_hat @ c_hat])]))

    def mass_matrix_factor(self) -> Array:
        """(6, 6) L, lower triangular in blocks, with M_o = L Lᵀ: exact for bodies whose M_o in numbers has no root.

        L = [√m 1, 0; √m ĉ, L_I] with L_I L_Iᵀ = I, √kg, √kg·m.
        """
        x, y, z = np.sqrt(self.mass) * self.p_OM
        arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        top = np.hstack([np.sqrt(self.mass) * np.eye(3), np.zeros((3, 3))])
        return freeze(np.vstack([top, np.hstack([arm, np.linalg.cholesky(self.inertia)])]))


def _inertia(value: Any) -> Array:
    inertia = arrays.check_array(value, "inertia", (3, 3))
    moments = np.linalg.eigvalsh(inertia)
    rounding = 1e-9 * np.abs(moments).max()  # nine digits: what a file carries
    if np.abs(inertia - inertia.T).max() > rounding:
        raise InvalidInput("inertia", value, "symmetric")
    if not _positive(inertia) or moments[0] <= 0.0 or moments[2] > moments[0] + moments[1] + rounding:
        allowed = "of principal moments that are positive, none greater than the sum of the other two"
        raise InvalidInput("inertia", moments, allowed)
    return inertia


def _positive(matrix: Array) -> bool:
    """Whether a symmetric matrix is positive definite beyond rounding."""
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True
