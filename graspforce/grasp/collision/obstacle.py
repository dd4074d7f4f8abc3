"""Obstacles: spheres, cylinders and boxes at rest, such as a table."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, MissingField
from graspforce.core.records import set_fields
from graspforce.geometry import Box, Cylinder, Solid, Sphere
from graspforce.geometry.poses import pose_from_dict, pose_to_dict


@dataclass(frozen=True, eq=False, slots=True)
class Obstacle:
    """A sphere, cylinder or box at rest.

    Args:
        shape: its surface, in its own frame O.
        p_HO: (3,) position in H, m.
        R_HO: (3, 3) orientation in H; the identity by default.

    Raises:
        InvalidInput: another shape, or a value out of range.
    """

    shape: Solid
    p_HO: Array
    R_HO: Array = field(default_factory=lambda: arrays.freeze(np.eye(3)))

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            shape: Solid,
            p_HO: npt.ArrayLike,
            R_HO: npt.ArrayLike = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        if not isinstance(self.shape, Sphere | Cylinder | Box):
            raise InvalidInput("shape", type(self.shape).__name__, "a Sphere, a Cylinder or a Box")
        p_HO, R_HO = arrays.check_array(self.p_HO, "p_HO", (3,)), arrays.check_rotation(self.R_HO, "R_HO")
        set_fields(self, p_HO=p_HO, R_HO=R_HO)

    @classmethod
    def from_dict(cls, record: object, field: str = "obstacle") -> Obstacle:
        """Return the obstacle of a record.

        Args:
            record: mapping with `shape` and the pose in H.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        p_HO, R_HO, values = pose_from_dict(record, field, ("shape",))
        if "shape" not in values:
            raise MissingField(f"{field}.shape")
        try:
            return cls(Solid.from_dict(values["shape"], "shape"), p_HO, R_HO)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> dict[str, object]:
        """Return the record of the obstacle."""
        return {"shape": self.shape.to_dict(), **pose_to_dict(self.p_HO, self.R_HO)}

    def distance(self, p_H: Array) -> Array:
        """Return the distances (M,) of points from the surface, m; negative inside.

        Args:
            p_H: (M, 3) points in H, m.
        """
        return np.asarray(self.shape.phi((p_H - self.p_HO) @ self.R_HO))


def check_obstacles(obstacles: object, field: str = "obstacles") -> tuple[Obstacle, ...]:
    """Return a list of obstacles.

    Args:
        obstacles: the value to check.
        field: its name for errors.

    Raises:
        InvalidInput: not a list, or an item that is not an obstacle; names the item.
    """
    items = fields.check_sequence(obstacles, field)
    for i, obstacle in enumerate(items):
        if not isinstance(obstacle, Obstacle):
            raise InvalidInput(f"{field}[{i}]", type(obstacle).__name__, "an Obstacle")
    return tuple(items)
