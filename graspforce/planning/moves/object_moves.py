"""Moves of an object as data: along a path, or free between two poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from graspforce.core import fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.geometry.poses import pose_from_dict, pose_to_dict
from graspforce.hand.hand import Hand
from graspforce.planning.failure import PlanFailure
from graspforce.planning.free.plan_free import plan_free
from graspforce.planning.free.workspace import UNBOUNDED, WorkspaceBounds, check_workspace
from graspforce.planning.given_points import check_poses, check_start_posture
from graspforce.planning.moves.records import check_move_record, errors_by_record_name, part, settings_of_record
from graspforce.planning.path.paths import ObjectPath, ScrewPath, SplinePath, StraightPath
from graspforce.planning.path.plan_along import plan_along
from graspforce.planning.plan import Plan
from graspforce.planning.progress import ProgressCallback
from graspforce.planning.settings import (
    DEFAULT_BUDGET,
    DEFAULT_TOLERANCE,
    PATH_INTERVALS,
    SEARCH_INTERVALS,
    PlanSettings,
)
from graspforce.planning.task import GraspTask, IdealTask, ObjectTask
from graspforce.planning.task_records import GRASP_TASK_FIELDS, IDEAL_TASK_FIELDS, OBJECT_FIELDS

PathType = Literal["straight", "screw", "spline"]
STRAIGHT: PathType = "straight"
SCREW: PathType = "screw"
SPLINE: PathType = "spline"


@dataclass(frozen=True, eq=False, slots=True)
class PathMove:
    """A move of an object along a path, planned by `plan_along`.

    Args:
        task: a task with an object.
        p_HO: (m, 3) positions of O in H at the start, at via points, and at the goal, m.
        R_HO: (m, 3, 3) orientations there, each less than half a turn from the one before.
        path_type: "straight" or "screw" between two poses, "spline" through any number.
        q_start: (n,) posture near the start, rad; the neutral posture if None.
        intervals: number of intervals between knots.
        tolerance: largest excess of a limit between knots, relative to the limit.

    Raises:
        InvalidInput: a value out of range, equal poses in a row, or another number of poses than the path joins.
    """

    task: ObjectTask
    p_HO: Array
    R_HO: Array
    path_type: PathType = STRAIGHT
    q_start: Array | None = None
    intervals: int = PATH_INTERVALS
    tolerance: float = DEFAULT_TOLERANCE

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            task: ObjectTask,
            p_HO: npt.ArrayLike,
            R_HO: npt.ArrayLike,
            path_type: PathType = STRAIGHT,
            q_start: npt.ArrayLike | None = None,
            intervals: int = PATH_INTERVALS,
            tolerance: float = DEFAULT_TOLERANCE,
        ) -> None: ...

    def __post_init__(self) -> None:
        PlanSettings(self.intervals, self.tolerance)  # checks both
        path_type = fields.check_choice(self.path_type, "path_type", (STRAIGHT, SCREW, SPLINE))
        _check_object_move(self, None if path_type == SPLINE else 2)

    @property
    def path(self) -> ObjectPath:
        """Return the path."""
        if self.path_type == SPLINE:
            return SplinePath.through(self.p_HO, self.R_HO)
        kind = StraightPath if self.path_type == STRAIGHT else ScrewPath
        return kind(self.p_HO[0], self.R_HO[0], self.p_HO[1], self.R_HO[1])

    def plan(self, *, budget: float = DEFAULT_BUDGET, callback: ProgressCallback | None = None) -> Plan | PlanFailure:
        """Plan the fastest motion along the path.

        Args:
            budget: time for planning, s.
            callback: function called with the `Progress` at every stage; it returns False to stop.
        """
        settings = PlanSettings(self.intervals, self.tolerance, budget)
        return plan_along(self.task, self.path, self.q_start, settings=settings, callback=callback)

    @classmethod
    def from_dict(cls, record: object, hand: Hand | None) -> PathMove:
        """Return the move of a record.

        Args:
            record: mapping that `to_dict` made.
            hand: the hand, which the record does not contain; None for ideal fingers.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        optional = (*_object_task_fields(hand), "way", "posture")
        values = check_move_record(record, (*OBJECT_FIELDS, "poses"), optional)
        options = {"path_type": values["way"]} if "way" in values else {}
        with errors_by_record_name():
            p_HO, R_HO = _poses_from_dicts(values["poses"])
            task, q_start = _object_task_from_dict(values, hand), values.get("posture")
            return cls(task, p_HO, R_HO, q_start=q_start, **options, **settings_of_record(values))

    def to_dict(self) -> JsonRecord:
        """Return the move as a record for JSON, without its hand.

        Raises:
            InvalidInput: the body's shape is an implicit surface, whose function cannot be saved or sent.
        """
        return {"method": "path", **_object_move_to_dict(self), "way": self.path_type}


@dataclass(frozen=True, eq=False, slots=True)
class FreeMove:
    """A move of an object from pose to pose whose path is optimised too, planned by `plan_free`.

    Args:
        task: a task with an object.
        p_HO: (2, 3) positions of O in H at start and goal, m.
        R_HO: (2, 3, 3) orientations there, less than half a turn apart.
        q_start: (n,) posture near the start, rad; the neutral posture if None.
        intervals: number of intervals between knots.
        workspace: bounds of the object's pose on its way.
        tolerance: largest excess of a limit between knots, relative to the limit.

    Raises:
        InvalidInput: a value out of range, equal poses, or another number of poses.
    """

    task: ObjectTask
    p_HO: Array
    R_HO: Array
    q_start: Array | None = None
    intervals: int = SEARCH_INTERVALS
    workspace: WorkspaceBounds = UNBOUNDED
    tolerance: float = DEFAULT_TOLERANCE

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(
            self,
            task: ObjectTask,
            p_HO: npt.ArrayLike,
            R_HO: npt.ArrayLike,
            q_start: npt.ArrayLike | None = None,
            intervals: int = SEARCH_INTERVALS,
            workspace: WorkspaceBounds = UNBOUNDED,
            tolerance: float = DEFAULT_TOLERANCE,
        ) -> None: ...

    def __post_init__(self) -> None:
        PlanSettings(self.intervals, self.tolerance)  # checks both
        _check_object_move(self, 2)
        check_workspace(self.workspace, self.p_HO)

    def plan(self, *, budget: float = DEFAULT_BUDGET, callback: ProgressCallback | None = None) -> Plan | PlanFailure:
        """Plan the fastest move.

        Args:
            budget: time for planning, s. When it ends, the best plan so far is returned.
            callback: function called with the `Progress` at every stage and iteration; it returns False to stop.
        """
        settings, options = PlanSettings(self.intervals, self.tolerance, budget), {"workspace": self.workspace}
        return plan_free(self.task, self.p_HO, self.R_HO, self.q_start, settings=settings, callback=callback, **options)

    @classmethod
    def from_dict(cls, record: object, hand: Hand | None) -> FreeMove:
        """Return the move of a record.

        Args:
            record: mapping that `to_dict` made.
            hand: the hand, which the record does not contain; None for ideal fingers.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        optional = (*_object_task_fields(hand), "posture", "room")
        values = check_move_record(record, (*OBJECT_FIELDS, "poses"), optional)
        with errors_by_record_name():
            p_HO, R_HO = _poses_from_dicts(values["poses"])
            task, workspace = _object_task_from_dict(values, hand), WorkspaceBounds.from_dict(values.get("room", {}), "room")
            return cls(task, p_HO, R_HO, q_start=values.get("posture"), workspace=workspace, **settings_of_record(values))

    def to_dict(self) -> JsonRecord:
        """Return the move as a record for JSON, without its hand.

        Raises:
            InvalidInput: the body's shape is an implicit surface, whose function cannot be saved or sent.
        """
        return {"method": "free", **_object_move_to_dict(self), "room": self.workspace.to_dict()}


def _check_object_move(move: PathMove | FreeMove, count: int | None) -> None:
    """Check and store the poses and the posture of a move of an object through ``count`` poses, or any number."""
    if not isinstance(move.task, ObjectTask):
        raise InvalidInput("task", type(move.task).__name__, "a task with an object; FingersMove moves fingers alone")
    p_HO, R_HO = check_poses(move.p_HO, move.R_HO, count)
    set_fields(move, p_HO=p_HO, R_HO=R_HO, q_start=check_start_posture(move.task, move.q_start))


def _object_task_fields(hand: Hand | None) -> tuple[str, ...]:
    return IDEAL_TASK_FIELDS if hand is None else GRASP_TASK_FIELDS


def _object_task_from_dict(values: JsonRecord, hand: Hand | None) -> ObjectTask:
    """Return the task of a move's record, which contains the fields of the task's own."""
    record = part(values, (*OBJECT_FIELDS, *_object_task_fields(hand)))
    return IdealTask.from_dict(record) if hand is None else GraspTask.from_dict(record, hand)


def _poses_from_dicts(records: object) -> tuple[Array, Array]:
    """Return the positions (m, 3) and orientations (m, 3, 3) of a list of poses."""
    items = fields.check_sequence(records, "poses", at_least=2)
    p_HO, R_HO = zip(*(pose_from_dict(pose, f"poses[{i}]")[:2] for i, pose in enumerate(items)), strict=True)
    return np.array(p_HO), np.array(R_HO)


def _object_move_to_dict(move: PathMove | FreeMove) -> JsonRecord:
    """Return the fields that moves of an object have in common."""
    posture = {} if move.q_start is None else {"posture": move.q_start.tolist()}
    task = move.task.to_dict()
    held: JsonRecord = {name: task.pop(name) for name in ("body", "rolling", "contacts") if name in task}
    return {
        **task,
        "intervals": move.intervals,
        "tolerance": move.tolerance,
        **held,
        "poses": [pose_to_dict(p, R) for p, R in zip(move.p_HO, move.R_HO, strict=True)],
        **posture,
    }
