"""Settings of collision checks: obstacles, and the distance to keep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.grasp.collision.obstacle import Obstacle, check_obstacles


@dataclass(frozen=True, eq=False, slots=True)
class CollisionSettings:
    """What a motion must not touch, and at what distance.

    Args:
        margin: least distance of all pairs that must not touch, m. Pairs that are nearer at the start or the goal, but do not
            overlap, keep the lesser of these two distances instead.
        obstacles: bodies at rest, such as a table, which neither links nor the object may touch.

    Raises:
        InvalidInput: a margin below zero, or something else than obstacles.
    """

    margin: float = 0.0
    obstacles: tuple[Obstacle, ...] = ()

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(self, margin: float = 0.0, obstacles: Sequence[Obstacle] = ()) -> None: ...

    def __post_init__(self) -> None:
        margin = arrays.check_number(self.margin, "margin", minimum=0.0)
        set_fields(self, margin=margin, obstacles=check_obstacles(self.obstacles))

    @classmethod
    def from_dict(cls, record: object, field: str = "collisions") -> CollisionSettings:
        """Return the settings of a record.

        Args:
            record: mapping that `to_dict` made; each field is optional.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, optional=["margin", "obstacles"])
        items = fields.check_sequence(values.get("obstacles", ()), f"{field}.obstacles")
        obstacles = [Obstacle.from_dict(item, f"{field}.obstacles[{i}]") for i, item in enumerate(items)]
        try:
            return cls(values.get("margin", 0.0), obstacles)
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> JsonRecord:
        """Return the settings as a record for JSON."""
        return {"margin": self.margin, "obstacles": [obstacle.to_dict() for obstacle in self.obstacles]}


DEFAULT_COLLISIONS = CollisionSettings()


def check_collision_settings(settings: object, field: str = "collisions") -> CollisionSettings | None:
    """Return collision settings, or None for no collision checks.

    Args:
        settings: the value to check.
        field: its name for errors.

    Raises:
        InvalidInput: neither settings nor None.
    """
    if settings is not None and not isinstance(settings, CollisionSettings):
        raise InvalidInput(field, type(settings).__name__, "a CollisionSettings, or None for no collision checks")
    return settings
