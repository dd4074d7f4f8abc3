"""Bounds of the object's motion on a free move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.json_text import JsonRecord
from graspforce.planning.path.paths import StraightPath

_BOUNDARY_TOLERANCE = 1e-9  # m


@dataclass(frozen=True, eq=False, slots=True)
class WorkspaceBounds:
    """Bounds of the object's pose on its way.

    Args:
        lower: (3,) lower bounds of its origin in H, m; −inf for none.
        upper: (3,) upper bounds of its origin in H, m; inf for none.
        turn: largest rotation about each axis beyond the range between start and goal, rad; inf for no bound.
    """

    lower: Array
    upper: Array
    turn: float

    @classmethod
    def from_dict(cls, record: object, field: str = "") -> WorkspaceBounds:
        """Return the bounds of a record.

        Args:
            record: mapping with optional `lower` and `upper` (m) and `turn` (rad); null stands for no bound.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, optional=["lower", "upper", "turn"])
        path = f"{field}." if field else ""
        lower = arrays.check_limits(values.get("lower"), f"{path}lower", 3, -np.inf)
        upper = arrays.check_limits(values.get("upper"), f"{path}upper", 3, np.inf)
        turn = values.get("turn")
        return cls(lower, upper, np.inf if turn is None else arrays.check_number(turn, f"{path}turn", minimum=0.0))

    def to_dict(self) -> JsonRecord:
        """Return the bounds as a record for JSON; no bound is null."""
        lower, upper = ([x if np.isfinite(x) else None for x in bound.tolist()] for bound in (self.lower, self.upper))
        return {"lower": lower, "upper": upper, "turn": self.turn if np.isfinite(self.turn) else None}

    def contains(self, path: StraightPath) -> bool:
        """Return whether a straight path stays inside; it rotates only between its ends.

        Args:
            path: the object's path.
        """
        p = path.points(np.array([0.0, 1.0])).p
        return bool((p >= self.lower - _BOUNDARY_TOLERANCE).all() and (p <= self.upper + _BOUNDARY_TOLERANCE).all())


UNBOUNDED = WorkspaceBounds(freeze(np.full(3, -np.inf)), freeze(np.full(3, np.inf)), np.inf)
