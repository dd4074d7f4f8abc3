"""Minimum-time moves of a held object, and of fingers alone."""

from __future__ import annotations

from graspforce.planning.failure import PlanFailure
from graspforce.planning.fingers.obstacles import Obstacle
from graspforce.planning.fingers.plan_fingers import plan_fingers
from graspforce.planning.free.plan_free import plan_free
from graspforce.planning.free.program import UNBOUNDED, WorkspaceBounds
from graspforce.planning.moves import FingersMove, FreeMove, Move, PathMove
from graspforce.planning.path.paths import JointPath, ObjectPath, ScrewPath, SplinePath, StraightPath
from graspforce.planning.path.plan_along import plan_along
from graspforce.planning.plan import Plan, PlanCheck, PlanningStatistics, Trajectory
from graspforce.planning.plan_files import save
from graspforce.planning.progress import Progress, ProgressCallback
from graspforce.planning.reference import joint_reference, object_reference
from graspforce.planning.task import Task

__all__ = [
    "UNBOUNDED",
    "FingersMove",
    "FreeMove",
    "JointPath",
    "Move",
    "ObjectPath",
    "Obstacle",
    "PathMove",
    "Plan",
    "PlanCheck",
    "PlanFailure",
    "PlanningStatistics",
    "Progress",
    "ProgressCallback",
    "ScrewPath",
    "SplinePath",
    "StraightPath",
    "Task",
    "Trajectory",
    "WorkspaceBounds",
    "joint_reference",
    "object_reference",
    "plan_along",
    "plan_fingers",
    "plan_free",
    "save",
]
