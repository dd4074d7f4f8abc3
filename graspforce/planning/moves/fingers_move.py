"""A move of fingers alone as data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.grasp.collision.obstacle import Obstacle, check_obstacles
from graspforce.hand.hand import Hand
from graspforce.planning.failure import PlanFailure
from graspforce.planning.fingers.plan_fingers import plan_fingers, plan_fingers_through
from graspforce.planning.given_points import check_posture, check_postures
from graspforce.planning.moves.records import check_move_record, errors_by_record_name, part, settings_of_record
from graspforce.planning.plan import Plan
from graspforce.planning.progress import ProgressCallback
from graspforce.planning.settings import (
    DEFAULT_BUDGET,
    DEFAULT_TOLERANCE,
    SEARCH_INTERVALS,
    PlanSettings,
)
from graspforce.planning.task import FingerTask
from graspforce.planning.task_records import FINGER_TASK_FIELDS


@dataclass(frozen=True, eq=False, slots=True)
class FingersMove:
    """A move of fingers alone.

    Between two postures the path is optimised by `plan_fingers`. With via postures it is a spline through all of them, planned
    by `plan_fingers_through`: where the spline lacks a clearance, there is no plan.

    Args:
        task: the hand.
        postures: (m, n) start first and goal last, rad.
        clearance: smallest distance between the spheres of two tips, and between a tip's sphere and an obstacle, m.
        obstacles: obstacles for the tips and links.
        intervals: number of intervals between knots.
        tolerance: largest excess of a limit between knots, relative to the limit.

    Raises:
        InvalidInput: a value out of range, a posture beyond the joint limits, or equal postures in a row.
    """

    task: FingerTask
    postures: Array
    clearance: float = 0.0
    obstacles: tuple[Obstacle, ...] = ()
    intervals: int = SEARCH_INTERVALS
    tolerance: float = DEFAULT_TOLERANCE

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            task: FingerTask,
            postures: npt.ArrayLike,
            clearance: float = 0.0,
            obstacles: Sequence[Obstacle] = (),
            intervals: int = SEARCH_INTERVALS,
            tolerance: float = DEFAULT_TOLERANCE,
        ) -> None: ...

    def __post_init__(self) -> None:
        PlanSettings(self.intervals, self.tolerance)  # checks both
        if not isinstance(self.task, FingerTask):
            raise InvalidInput("task", type(self.task).__name__, "a FingerTask; PathMove and FreeMove move an object")
        postures = check_postures(self.task.hand, self.postures, "postures")
        clearance = arrays.check_number(self.clearance, "clearance", minimum=0.0)
        set_fields(self, postures=postures, clearance=clearance, obstacles=check_obstacles(self.obstacles))

    @classmethod
    def through_tips(
        cls,
        task: FingerTask,
        tips: Sequence[Mapping[str, npt.ArrayLike]],
        q_start: npt.ArrayLike | None = None,
        *,
        clearance: float = 0.0,
        obstacles: Sequence[Obstacle] = (),
    ) -> FingersMove:
        """Return the move that takes fingertips through positions, one after the other without a stop.

        The posture at each position follows from inverse kinematics, which starts from the posture before.

        Args:
            task: the hand.
            tips: for each place of the move, by finger, the (3,) position of its tip frame in H, m; the last one is the goal.
                Fingers that are not named keep their posture.
            q_start: (n,) posture at the start, rad; the neutral posture by default.
            clearance: as of the move.
            obstacles: as of the move.

        Raises:
            InvalidInput: no places, a position out of its finger's reach, or a place where the fingertips are already.
            UnknownName: no such finger.
        """
        postures = [task.hand.neutral if q_start is None else check_posture(task.hand, q_start, "q_start")]
        if not tips:
            raise InvalidInput("tips", tips, "at least one place")
        for i, place in enumerate(tips):
            try:
                postures.append(task.hand.tip_posture(place, postures[-1]))
            except InvalidInput as error:
                raise error.with_field(f"tips[{i}]{error.field.removeprefix('tips')}") from None
        return cls(task, np.array(postures), clearance, obstacles)

    def plan(self, *, budget: float = DEFAULT_BUDGET, callback: ProgressCallback | None = None) -> Plan | PlanFailure:
        """Plan the fastest move.

        Args:
            budget: time for planning, s. When it ends, the best plan so far is returned.
            callback: function called with the `Progress` at every stage and iteration; it returns False to stop.
        """
        settings = PlanSettings(self.intervals, self.tolerance, budget)
        if len(self.postures) > 2:
            clearances = self.clearance, self.obstacles
            return plan_fingers_through(self.task, self.postures, *clearances, settings=settings, callback=callback)
        return plan_fingers(
            self.task,
            *self.postures,
            clearance=self.clearance,
            obstacles=self.obstacles,
            settings=settings,
            callback=callback,
        )

    @classmethod
    def from_dict(cls, record: object, hand: Hand) -> FingersMove:
        """Return the move of a record.

        Args:
            record: mapping that `to_dict` made.
            hand: the hand, which the record does not contain.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        optional = (*FINGER_TASK_FIELDS, "apart", "obstacles", "slip_margin")  # the slip margin has no effect
        values = check_move_record(record, ("postures",), optional)
        items = fields.check_sequence(values.get("obstacles", ()), "obstacles")
        obstacles = tuple(Obstacle.from_dict(item, f"obstacles[{i}]") for i, item in enumerate(items))
        clearance = {"clearance": values["apart"]} if "apart" in values else {}
        with errors_by_record_name():
            task = FingerTask.from_dict(part(values, FINGER_TASK_FIELDS), hand)
            return cls(task, values["postures"], obstacles=obstacles, **clearance, **settings_of_record(values))

    def to_dict(self) -> JsonRecord:
        """Return the move as a record for JSON, without its hand."""
        task = self.task.to_dict()
        return {
            "method": "fingers",
            "gravity": task.pop("gravity"),
            "slip_margin": 0.0,
            **task,
            "intervals": self.intervals,
            "tolerance": self.tolerance,
            "postures": self.postures.tolist(),
            "apart": self.clearance,
            "obstacles": [obstacle.to_dict() for obstacle in self.obstacles],
        }
