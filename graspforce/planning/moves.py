"""What is to be planned, as data: it can be kept, sent elsewhere, and planned there. Each kind goes with its planner.

A move's ``plan(budget=…, callback=…)`` is the planner called with what the move says.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.planning.check import TOLERANCE
from graspforce.planning.failure import PlanFailure
from graspforce.planning.fingers.obstacles import Obstacle
from graspforce.planning.fingers.plan_fingers import plan_fingers
from graspforce.planning.free.plan_free import plan_free
from graspforce.planning.free.program import UNBOUNDED, WorkspaceBounds
from graspforce.planning.path.paths import JointPath, ObjectPath, ScrewPath, SplinePath, StraightPath
from graspforce.planning.path.plan_along import plan_along
from graspforce.planning.plan import Plan
from graspforce.planning.progress import DEFAULT_BUDGET, ProgressCallback
from graspforce.planning.task import Task

STRAIGHT, SCREW, SPLINE = "straight", "screw", "spline"


@dataclass(frozen=True, eq=False, slots=True)
class PathMove:
    """An object along a path, through `plan_along`.

    Args:
        task: with an object.
        p_HO: (m, 3) O's origin in H at the start, at via points, and at the goal, m.
        R_HO: (m, 3, 3) O's axes in H there; each less than half a turn from the one before.
        way: between them: ``straight`` or ``screw`` between two poses, or ``spline`` through any number.
        q_start: (n,) a posture near the start, rad; None for neutral.
        intervals, tolerance: as `plan_along`.

    Raises:
        InvalidInput: poses that are none, or of another number than the way joins.
    """

    task: Task
    p_HO: Array
    R_HO: Array
    path_type: str = STRAIGHT
    q_start: Array | None = None
    intervals: int = 100
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        _pose_arrays(self)
        if fields.check_choice(self.path_type, "path_type", (STRAIGHT, SCREW, SPLINE)) != SPLINE:
            _check_two_poses(self.p_HO, "p_HO")
        _check_start(self)

    def path(self) -> ObjectPath:
        """The path that it says."""
        if self.path_type == SPLINE:
            return SplinePath.through(self.p_HO, self.R_HO)
        kind = StraightPath if self.path_type == STRAIGHT else ScrewPath
        return kind(self.p_HO[0], self.R_HO[0], self.p_HO[1], self.R_HO[1])

    def plan(self, *, budget: float = DEFAULT_BUDGET, callback: ProgressCallback | None = None) -> Plan | PlanFailure:
        """The fastest motion along it, or why there is none."""
        rest: dict[str, Any] = {"intervals": self.intervals, "tolerance": self.tolerance}
        return plan_along(self.task, self.path(), self.q_start, budget=budget, callback=callback, **rest)


@dataclass(frozen=True, eq=False, slots=True)
class FreeMove:
    """An object from pose to pose whichever way is fastest, through `plan_free`.

    Args:
        task: with an object.
        p_HO, R_HO: (2, 3) and (2, 3, 3) the poses at start and goal, as of `PathMove`.
        q_start: (n,) a posture near the start, rad; None for neutral.
        intervals, room, tolerance: as `plan_free`.

    Raises:
        InvalidInput: poses that are none, or more than two.
    """

    task: Task
    p_HO: Array
    R_HO: Array
    q_start: Array | None = None
    intervals: int = 40
    workspace: WorkspaceBounds = UNBOUNDED
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        _pose_arrays(self)
        _check_two_poses(self.p_HO, "p_HO")
        _check_start(self)

    def plan(self, *, budget: float = DEFAULT_BUDGET, callback: ProgressCallback | None = None) -> Plan | PlanFailure:
        """The fastest move that is found, or why there is none."""
        (p_start, p_goal), (R_start, R_goal) = self.p_HO, self.R_HO
        rest: dict[str, Any] = {"intervals": self.intervals, "workspace": self.workspace, "tolerance": self.tolerance}
        ends = (p_start, R_start, p_goal, R_goal)
        return plan_free(self.task, *ends, self.q_start, budget=budget, callback=callback, **rest)


@dataclass(frozen=True, eq=False, slots=True)
class FingersMove:
    """Fingers alone: from posture to posture round what is in their way, through `plan_fingers`; or, where via postures are
    given, along a spline through all of them, through `plan_along`.

    Args:
        task: without an object.
        postures: (m, n) start first, goal last, rad.
        apart, obstacles: as `plan_fingers`; not where via postures are given.
        intervals, tolerance: as `plan_fingers`.

    Raises:
        InvalidInput: postures that are none.
    """

    task: Task
    postures: Array
    clearance: float = 0.0
    obstacles: tuple[Obstacle, ...] = ()
    intervals: int = 40
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        object.__setattr__(self, "postures", arrays.check_array(self.postures, "postures", (None, self.task.joints)))
        object.__setattr__(self, "clearance", arrays.check_number(self.clearance, "clearance", minimum=0.0))
        object.__setattr__(self, "obstacles", tuple(self.obstacles))
        if len(self.postures) < 2:
            raise InvalidInput("postures", self.postures, "at least two")
        if len(self.postures) > 2 and (self.clearance > 0.0 or self.obstacles):
            raise InvalidInput("postures", f"{len(self.postures)} postures", "two, where tips must keep clear of something")

    def plan(self, *, budget: float = DEFAULT_BUDGET, callback: ProgressCallback | None = None) -> Plan | PlanFailure:
        """The fastest move that is found, or why there is none."""
        rest: dict[str, Any] = {
            "intervals": self.intervals,
            "tolerance": self.tolerance,
            "budget": budget,
            "callback": callback,
        }
        if len(self.postures) > 2:
            return plan_along(self.task, JointPath.through(self.postures), **rest)
        return plan_fingers(self.task, *self.postures, clearance=self.clearance, obstacles=self.obstacles, **rest)


Move = PathMove | FreeMove | FingersMove


def _pose_arrays(move: PathMove | FreeMove) -> None:
    p_HO = arrays.check_array(move.p_HO, "p_HO", (None, 3))
    R_HO = arrays.check_array(move.R_HO, "R_HO", (len(p_HO), 3, 3))
    if len(p_HO) < 2:
        raise InvalidInput("p_HO", p_HO, "at least two poses")
    for i, R in enumerate(R_HO):
        arrays.check_rotation(R, f"R_HO[{i}]")
    object.__setattr__(move, "p_HO", p_HO)
    object.__setattr__(move, "R_HO", R_HO)


def _check_two_poses(p_HO: Array, field: str) -> None:
    if len(p_HO) != 2:
        raise InvalidInput(field, f"{len(p_HO)} poses", "two: start and goal")


def _check_start(move: PathMove | FreeMove) -> None:
    if move.task.body is None:
        raise InvalidInput("task", "no object", "one with an object; fingers alone go with FingersMove")
    if move.q_start is not None:
        object.__setattr__(move, "q_start", arrays.check_array(move.q_start, "q_start", (move.task.joints,)))
