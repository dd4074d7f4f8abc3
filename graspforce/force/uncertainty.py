"""Errors that the forces of a problem must survive: friction, load, contact places and frames, and drives.

The squeeze f₀ is fixed: it is planned for the nominal data. The true data differ, and the reaction spreads the wrench that f₀
does not supply over the contacts as the forces of least norm,

    f = f₀ + q + G⁺ (w − G (f₀ + q)),    Jᵀ q = errors of the torques,

with moments divided by the characteristic length. G is the true grasp matrix and w the true wrench. All f must be in the true
friction cones, with a stated slip margin, and within the limits of normal forces and motors.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactModel, ContactSet
from graspforce.core import arrays
from graspforce.core import fields as field_checks
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields

_BY_CONTACT = ("friction_error", "position_error", "normal_error")
_MAX_VERTICES = 64
_MAX_CONES = 4096  # vertices times contacts: their cone program takes about a second


@dataclass(frozen=True, eq=False, slots=True)
class Uncertainty:
    """Bounds on the errors of a force problem. The forces hold for every combination of errors within them.

    Args:
        friction_error: fraction e of friction, one number or (N,), in [0, 1): the true μ and γ are at least (1 − e) times the
            modelled ones.
        mass_error: fraction e in [0, 1): the true wrench is (1 − e) to (1 + e) times the modelled one.
        centre_of_mass_error: (3,) half-widths of the box of displacements d of the load's line of action, in O, m; one number
            for a cube. The moment changes by d × force.
        wrenches: (V, 6) further wrenches about O, in O, N and N·m: the true wrench has in addition any point of the convex
            hull of zero and of these.
        wrench_ellipsoid: (6, d) matrix E: the true wrench has in addition E u with ‖u‖ ≤ 1, N and N·m.
        position_error: largest distance of a contact from its place, one number or (N,), m.
        normal_error: largest angle of a contact's normal, one number or (N,), rad. Contacts must have more friction.
        torque_error: largest error of each motor's torque as a fraction of it, one number or (n,), in [0, 1).
        slip_margin: slip margin that all contacts with friction keep, N.

    Raises:
        InvalidInput: a value outside its range.
    """

    friction_error: Array
    mass_error: float
    centre_of_mass_error: Array
    wrenches: Array
    wrench_ellipsoid: Array
    position_error: Array
    normal_error: Array
    torque_error: Array
    slip_margin: float

    def __init__(
        self,
        friction_error: npt.ArrayLike = 0.0,
        mass_error: float = 0.0,
        centre_of_mass_error: npt.ArrayLike = 0.0,
        wrenches: npt.ArrayLike | None = None,
        wrench_ellipsoid: npt.ArrayLike | None = None,
        position_error: npt.ArrayLike = 0.0,
        normal_error: npt.ArrayLike = 0.0,
        torque_error: npt.ArrayLike = 0.0,
        slip_margin: float = 0.0,
    ) -> None:
        centre = _numbers(centre_of_mass_error, "centre_of_mass_error")
        if centre.shape not in ((1,), (3,)):
            raise InvalidInput("centre_of_mass_error", centre_of_mass_error, "one number, or a list of 3")
        set_fields(
            self,
            friction_error=_fractions(friction_error, "friction_error"),
            mass_error=float(_fractions(arrays.check_number(mass_error, "mass_error"), "mass_error")[0]),
            centre_of_mass_error=arrays.freeze(np.broadcast_to(centre, 3)),
            wrenches=_matrix([] if wrenches is None else wrenches, "wrenches", (None, 6)),
            wrench_ellipsoid=_matrix(
                np.zeros((6, 0)) if wrench_ellipsoid is None else wrench_ellipsoid, "wrench_ellipsoid", (6, None)
            ),
            position_error=_numbers(position_error, "position_error"),
            normal_error=_numbers(normal_error, "normal_error"),
            torque_error=_fractions(torque_error, "torque_error"),
            slip_margin=arrays.check_number(slip_margin, "slip_margin", minimum=0.0),
        )
        if len(self.wrenches) > _MAX_VERTICES:
            raise InvalidInput("wrenches", f"{len(self.wrenches)} wrenches", f"at most {_MAX_VERTICES}")

    def times(self, factor: float) -> Uncertainty:
        """Return the errors multiplied by a factor; the slip margin stays.

        Args:
            factor: at least 0, with which all fractions stay below 1.

        Raises:
            InvalidInput: a fraction would reach 1.
        """
        values = {each.name: factor * getattr(self, each.name) for each in fields(self)}
        return Uncertainty(**{**values, "mass_error": float(values["mass_error"]), "slip_margin": self.slip_margin})

    def check(self, contacts: ContactSet, joints: int) -> None:
        """Raise an error unless the errors fit contacts and motors.

        Args:
            contacts: the contacts.
            joints: the number n of motors.

        Raises:
            InvalidInput: another number of values, too many vertices, or normals whose error leaves no friction.
        """
        vertices = (2 if self.mass_error else 1) * 2 ** np.count_nonzero(self.centre_of_mass_error) * (len(self.wrenches) + 1)
        if vertices * len(contacts) > _MAX_CONES:
            allowed = f"at most {_MAX_CONES}, with the vertices of mass and centre of mass"
            raise InvalidInput("wrenches", f"{vertices} vertices at {len(contacts)} contacts", allowed)
        for name in _BY_CONTACT:
            _check_length(getattr(self, name), name, len(contacts), "contacts")
        _check_length(self.torque_error, "torque_error", joints, "motors")
        if not self.normal_error.any():
            return
        tilt = np.broadcast_to(self.normal_error, len(contacts))
        if any(model is ContactModel.FRICTIONLESS and angle for model, angle in zip(contacts.models, tilt, strict=True)):
            raise InvalidInput("normal_error", self.normal_error.tolist(), "0 at frictionless contacts")
        angles = np.arctan(contacts.mu * (1.0 - self.friction_error))
        for i in np.flatnonzero(tilt >= angles):
            if tilt[i] > 0.0:
                allowed = f"less than {angles[i]:.4g} rad at contact {i}, the angle of its least friction"
                raise InvalidInput("normal_error", float(tilt[i]), allowed)

    @classmethod
    def from_dict(cls, record: object, field: str = "uncertainty") -> Uncertainty:
        """Return the uncertainty of the ``uncertainty`` record of a problem file.

        Args:
            record: mapping with the fields by name; absent ones take their defaults.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is unknown or has a value that is not allowed.
        """
        values = field_checks.check_record(record, field, optional=[each.name for each in fields(cls)])
        try:
            return cls(**{name: value for name, value in values.items() if value is not None})
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> JsonRecord:
        """Return the ``uncertainty`` record of a problem file, without fields that are zero."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return {
            name: value if isinstance(value, float) else value.tolist()
            for name, value in values.items()
            if np.asarray(value).any()
        }


def _numbers(value: object, name: str) -> Array:
    """Return one or several numbers ≥ 0 as a vector."""
    value = [value] if np.ndim(value) == 0 else value  # type: ignore[arg-type]
    return arrays.check_array(value, name, (None,), minimum=0.0)


def _fractions(value: object, name: str) -> Array:
    """Return one or several numbers in [0, 1) as a vector."""
    numbers = _numbers(value, name)
    for x in numbers[numbers >= 1.0]:
        raise InvalidInput(name, float(x), "less than 1")
    return numbers


def _matrix(value: npt.ArrayLike, name: str, shape: tuple[int | None, int | None]) -> Array:
    """Return a matrix of finite numbers; an empty list has no rows."""
    if np.size(value) == 0:
        return arrays.freeze(np.zeros([0 if n is None else n for n in shape]))
    return arrays.check_array(value, name, shape)


def _check_length(values: Array, name: str, count: int, items: str) -> None:
    """Raise an error unless there is one value, or one for each item."""
    if len(values) not in (1, count):
        raise InvalidInput(name, values.tolist(), f"one number, or one for each of {count} {items}")
