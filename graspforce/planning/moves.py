"""Moves as data: a task, start and goal, and the options of its planner. A move can be saved, sent, and planned elsewhere."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, MissingField
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.geometry.poses import pose_from_dict, pose_to_dict
from graspforce.hand.hand import Hand
from graspforce.planning.failure import PlanFailure
from graspforce.planning.fingers.obstacles import Obstacle
from graspforce.planning.fingers.plan_fingers import plan_fingers
from graspforce.planning.free.plan_free import plan_free
from graspforce.planning.free.workspace import UNBOUNDED, WorkspaceBounds
from graspforce.planning.path.paths import JointPath, ObjectPath, ScrewPath, SplinePath, StraightPath
from graspforce.planning.path.plan_along import plan_along, plan_fingers_along
from graspforce.planning.plan import Plan
from graspforce.planning.progress import ProgressCallback
from graspforce.planning.settings import (
    DEFAULT_BUDGET,
    DEFAULT_TOLERANCE,
    PATH_INTERVALS,
    SEARCH_INTERVALS,
    PlanSettings,
)
from graspforce.planning.task import (
    FINGER_TASK_FIELDS,
    GRASP_TASK_FIELDS,
    IDEAL_TASK_FIELDS,
    OBJECT_FIELDS,
    FingerTask,
    GraspTask,
    IdealTask,
    ObjectTask,
)

PathType = Literal["straight", "screw", "spline"]
STRAIGHT: PathType = "straight"
SCREW: PathType = "screw"
SPLINE: PathType = "spline"

# Python's name of a field: its name in a record, where the two differ
_RECORD_NAMES = {"p_HO": "poses", "q_start": "posture", "path_type": "way", "clearance": "apart", "workspace": "room"}
_SETTING_FIELDS = ("intervals", "tolerance")


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
        InvalidInput: a value out of range, or another number of poses than the path joins.
    """

    task: ObjectTask
    p_HO: Array
    R_HO: Array
    path_type: PathType = STRAIGHT
    q_start: Array | None = None
    intervals: int = PATH_INTERVALS
    tolerance: float = DEFAULT_TOLERANCE

    def __post_init__(self) -> None:
        _check_settings(self)
        _check_object_move(self)
        if fields.check_choice(self.path_type, "path_type", (STRAIGHT, SCREW, SPLINE)) != SPLINE:
            _check_two_poses(self.p_HO)

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
        values = _check_move_record(record, (*OBJECT_FIELDS, "poses"), optional)
        options = {"path_type": values["way"]} if "way" in values else {}
        with _errors_by_record_name():
            p_HO, R_HO = _poses_from_dicts(values["poses"])
            task, q_start = _object_task_from_dict(values, hand), values.get("posture")
            return cls(task, p_HO, R_HO, q_start=q_start, **options, **_settings(values))

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
        InvalidInput: a value out of range, or another number of poses.
    """

    task: ObjectTask
    p_HO: Array
    R_HO: Array
    q_start: Array | None = None
    intervals: int = SEARCH_INTERVALS
    workspace: WorkspaceBounds = UNBOUNDED
    tolerance: float = DEFAULT_TOLERANCE

    def __post_init__(self) -> None:
        _check_settings(self)
        _check_object_move(self)
        _check_two_poses(self.p_HO)

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
        values = _check_move_record(record, (*OBJECT_FIELDS, "poses"), optional)
        with _errors_by_record_name():
            p_HO, R_HO = _poses_from_dicts(values["poses"])
            task, workspace = _object_task_from_dict(values, hand), WorkspaceBounds.from_dict(values.get("room", {}), "room")
            return cls(task, p_HO, R_HO, q_start=values.get("posture"), workspace=workspace, **_settings(values))

    def to_dict(self) -> JsonRecord:
        """Return the move as a record for JSON, without its hand.

        Raises:
            InvalidInput: the body's shape is an implicit surface, whose function cannot be saved or sent.
        """
        return {"method": "free", **_object_move_to_dict(self), "room": self.workspace.to_dict()}


@dataclass(frozen=True, eq=False, slots=True)
class FingersMove:
    """A move of fingers alone.

    Between two postures the path is optimised by `plan_fingers`. With via postures it is a spline through all of them, planned
    by `plan_fingers_along`, which keeps no clearances.

    Args:
        task: the hand.
        postures: (m, n) start first and goal last, rad.
        clearance: smallest distance between the spheres of two tips, and between a tip's sphere and an obstacle, m.
        obstacles: obstacles for the tips.
        intervals: number of intervals between knots.
        tolerance: largest excess of a limit between knots, relative to the limit.

    Raises:
        InvalidInput: a value out of range, or clearances with via postures.
    """

    task: FingerTask
    postures: Array
    clearance: float = 0.0
    obstacles: tuple[Obstacle, ...] = ()
    intervals: int = SEARCH_INTERVALS
    tolerance: float = DEFAULT_TOLERANCE

    def __post_init__(self) -> None:
        _check_settings(self)
        if not isinstance(self.task, FingerTask):
            raise InvalidInput("task", type(self.task).__name__, "a FingerTask; PathMove and FreeMove move an object")
        postures = arrays.check_array(self.postures, "postures", (None, self.task.joint_count))
        clearance = arrays.check_number(self.clearance, "clearance", minimum=0.0)
        set_fields(self, postures=postures, clearance=clearance, obstacles=tuple(self.obstacles))
        if len(postures) < 2:
            raise InvalidInput("postures", postures, "at least two postures")
        if len(postures) > 2 and (clearance > 0.0 or self.obstacles):
            raise InvalidInput("postures", f"{len(postures)} postures", "two postures if tips must keep a clearance")

    def plan(self, *, budget: float = DEFAULT_BUDGET, callback: ProgressCallback | None = None) -> Plan | PlanFailure:
        """Plan the fastest move.

        Args:
            budget: time for planning, s. When it ends, the best plan so far is returned.
            callback: function called with the `Progress` at every stage and iteration; it returns False to stop.
        """
        settings = PlanSettings(self.intervals, self.tolerance, budget)
        if len(self.postures) > 2:
            return plan_fingers_along(self.task, JointPath.through(self.postures), settings=settings, callback=callback)
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
        values = _check_move_record(record, ("postures",), optional)
        items = fields.check_sequence(values.get("obstacles", ()), "obstacles")
        obstacles = tuple(Obstacle.from_dict(item, f"obstacles[{i}]") for i, item in enumerate(items))
        clearance = {"clearance": values["apart"]} if "apart" in values else {}
        with _errors_by_record_name():
            task = FingerTask.from_dict(_part(values, FINGER_TASK_FIELDS), hand)
            return cls(task, values["postures"], obstacles=obstacles, **clearance, **_settings(values))

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


Move: TypeAlias = PathMove | FreeMove | FingersMove

_MOVES: dict[str, type[PathMove | FreeMove | FingersMove]] = {"path": PathMove, "free": FreeMove, "fingers": FingersMove}
METHODS = tuple(_MOVES)


def move_from_dict(record: object, hand: Hand) -> Move:
    """Return the move of a record, of the kind that its ``method`` names.

    Args:
        record: mapping that a move's `to_dict` made.
        hand: the hand, which the record does not contain.

    Raises:
        InvalidInput: a field is missing, unknown or out of range; names it with its path.
    """
    if not isinstance(record, Mapping) or "method" not in record:
        raise MissingField("method", f"one of {', '.join(METHODS)}")
    return _MOVES[fields.check_choice(record["method"], "method", METHODS)].from_dict(record, hand)


def _check_settings(move: Move) -> None:
    """Raise InvalidInput unless the number of intervals and the tolerance are in range."""
    PlanSettings(move.intervals, move.tolerance)


def _check_object_move(move: PathMove | FreeMove) -> None:
    """Check and store the poses and the posture of a move of an object."""
    if not isinstance(move.task, ObjectTask):
        raise InvalidInput("task", type(move.task).__name__, "a task with an object; FingersMove moves fingers alone")
    p_HO = arrays.check_array(move.p_HO, "p_HO", (None, 3))
    R_HO = arrays.check_array(move.R_HO, "R_HO", (len(p_HO), 3, 3))
    if len(p_HO) < 2:
        raise InvalidInput("p_HO", p_HO, "at least two poses")
    for i, R in enumerate(R_HO):
        arrays.check_rotation(R, f"R_HO[{i}]")
    set_fields(move, p_HO=p_HO, R_HO=R_HO)
    if move.q_start is not None:
        set_fields(move, q_start=arrays.check_array(move.q_start, "q_start", (move.task.joint_count,)))


def _check_two_poses(p_HO: Array) -> None:
    if len(p_HO) != 2:
        raise InvalidInput("p_HO", f"{len(p_HO)} poses", "two poses, start and goal")


def _check_move_record(record: object, required: tuple[str, ...], optional: tuple[str, ...]) -> JsonRecord:
    """Return the fields of a move's record that are not null."""
    values = fields.check_record(record, "", required=("method", *required), optional=(*optional, *_SETTING_FIELDS))
    for name in required:
        if values[name] is None:
            raise MissingField(name)
    return {name: value for name, value in values.items() if value is not None}


@contextmanager
def _errors_by_record_name() -> Iterator[None]:
    """Name the fields of errors as in a record."""
    try:
        yield
    except InvalidInput as error:
        name, bracket, index = error.field.partition("[")
        raise error.with_field(_RECORD_NAMES.get(name, name) + bracket + index) from None


def _object_task_fields(hand: Hand | None) -> tuple[str, ...]:
    return IDEAL_TASK_FIELDS if hand is None else GRASP_TASK_FIELDS


def _object_task_from_dict(values: JsonRecord, hand: Hand | None) -> ObjectTask:
    """Return the task of a move's record, which contains the fields of the task's own."""
    record = _part(values, (*OBJECT_FIELDS, *_object_task_fields(hand)))
    return IdealTask.from_dict(record) if hand is None else GraspTask.from_dict(record, hand)


def _part(values: JsonRecord, names: tuple[str, ...]) -> JsonRecord:
    return {name: values[name] for name in names if name in values}


def _settings(values: JsonRecord) -> JsonRecord:
    return _part(values, _SETTING_FIELDS)


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
