"""Lagrange multipliers of a force problem: of an optimum, or of a proof of infeasibility."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.json_text import JsonRecord

_ORIGIN = arrays.freeze(np.zeros(3))
_RECORD = ("y", "normal_lower", "normal_upper", "torque_lower", "torque_upper", "level")


@dataclass(frozen=True, eq=False, slots=True)
class Multipliers:
    """Lagrange multipliers of equilibrium and of the limits; all but y are ≥ 0.

    The multipliers z of the friction cones are not stored. They follow from stationarity:

        z = ∇cost − Gᵀ y − E (normal_lower − normal_upper) − J (torque_lower − torque_upper),   z in K*,

    where E places one value per contact in the row of its normal force, and K* is the dual cone.

    Args:
        y: (6,) of G f = w, with the moments of G and w about ``point``, in O; cost per N, and per N·m.
        normal_lower: (N,) of f_n ≥ min, cost per N.
        normal_upper: (N,) of f_n ≤ max, cost per N.
        torque_lower: (n,) of tau ≥ lower, cost per N·m.
        torque_upper: (n,) of tau ≤ upper, cost per N·m.
        level: (N,) of f_n ≤ t for the objective "max_normal", with the sum 1; zeros otherwise.
        point: (3,) reference point of moments, in O, m. Solvers use the contacts' centroid, where rounding is smallest.
    """

    y: Array
    normal_lower: Array
    normal_upper: Array
    torque_lower: Array
    torque_upper: Array
    level: Array
    point: Array = field(default_factory=lambda: _ORIGIN)

    def about(self, point: Array) -> Multipliers:
        """Return the same multipliers with moments about another point: yᵀG stays the same.

        Args:
            point: (3,) in O, m.
        """
        if np.array_equal(point, self.point):
            return self
        force = self.y[:3] + np.cross(self.point - point, self.y[3:])
        return replace(self, y=np.concatenate([force, self.y[3:]]), point=point)

    def to_dict(self) -> JsonRecord:
        """Return the record, with moments about O's origin."""
        about_O = self.about(_ORIGIN)
        return {name: getattr(about_O, name).tolist() for name in _RECORD}

    @classmethod
    def from_dict(cls, record: object, field: str = "multipliers") -> Multipliers:
        """Return the multipliers of a record, with moments about O's origin.

        Args:
            record: as `to_dict` returns it.
            field: its path, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or not a list of numbers.
        """
        values = fields.check_record(record, field, required=_RECORD)
        return cls(*(arrays.check_array(values[name], f"{field}.{name}", (None,)) for name in _RECORD))
