"""Bounds of the object's motion on a free move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.planning.path.paths import StraightPath

_BOUNDARY_TOLERANCE = 1e-9  # m


@dataclass(frozen=True, eq=False, slots=True)
class WorkspaceBounds:
    """Bounds of the object's pose on its way.

    Args:
        lower: (3,) lower bounds of its origin in H, m; None or −inf for no bound.
        upper: (3,) upper bounds of its origin in H, m; None or inf for no bound.
        turn: largest rotation about each axis beyond the range between start and goal, rad; None or inf for no bound.

    Raises:
        InvalidInput: a value out of range, or a lower bound above the upper one.
    """

    lower: Array = None  # type: ignore[assignment]  # the constructor makes an array of it
    upper: Array = None  # type: ignore[assignment]
    turn: float = np.inf

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self, lower: npt.ArrayLike | None = None, upper: npt.ArrayLike | None = None, turn: float | None = None
        ) -> None: ...

    def __post_init__(self) -> None:
        lower = arrays.check_limits(self.lower, "lower", 3, -np.inf)
        upper = arrays.check_limits(self.upper, "upper", 3, np.inf)
        if (lower > upper).any():
            raise InvalidInput("lower", lower, f"at most upper, which is {upper.tolist()}")
        turn = np.inf if self.turn is None or self.turn == np.inf else arrays.check_number(self.turn, "turn", minimum=0.0)
        set_fields(self, lower=lower, upper=upper, turn=turn)

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
        try:
            return cls(values.get("lower"), values.get("upper"), values.get("turn"))
        except InvalidInput as error:
            raise error.with_prefix(field) from None

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


UNBOUNDED = WorkspaceBounds()


def check_workspace(workspace: object, p_HO: Array) -> WorkspaceBounds:
    """Return the bounds of a move's workspace, which contain its start and its goal.

    Args:
        workspace: the bounds.
        p_HO: (2, 3) positions of O in H at start and goal, m.

    Raises:
        InvalidInput: not a `WorkspaceBounds`, or the start or the goal is outside.
    """
    if not isinstance(workspace, WorkspaceBounds):
        raise InvalidInput("workspace", type(workspace).__name__, "a WorkspaceBounds")
    for where, p in zip(("start", "goal"), p_HO, strict=True):
        if (p < workspace.lower - _BOUNDARY_TOLERANCE).any():
            raise InvalidInput("workspace.lower", workspace.lower, f"at most the position of the {where}, {p.tolist()} m")
        if (p > workspace.upper + _BOUNDARY_TOLERANCE).any():
            raise InvalidInput("workspace.upper", workspace.upper, f"at least the position of the {where}, {p.tolist()} m")
    return workspace
