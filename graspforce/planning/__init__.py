"""Minimum-time moves of an object in a hand, of an object between ideal fingers, and of fingers alone."""

from __future__ import annotations

from graspforce.core.optional_libraries import optional_imports

with optional_imports("casadi"):
    from graspforce.grasp.collision.obstacle import Obstacle
    from graspforce.grasp.collision.settings import CollisionSettings
    from graspforce.planning.acceleration_limits import AccelerationLimits
    from graspforce.planning.failure import PlanFailure
    from graspforce.planning.fingers.plan_fingers import plan_fingers, plan_fingers_through
    from graspforce.planning.free.plan_free import plan_free
    from graspforce.planning.free.workspace import UNBOUNDED, WorkspaceBounds
    from graspforce.planning.moves.fingers_move import FingersMove
    from graspforce.planning.moves.move import Move, move_from_dict
    from graspforce.planning.moves.object_moves import FreeMove, PathMove
    from graspforce.planning.path.paths import JointPath, ObjectPath, ScrewPath, SplinePath, StraightPath
    from graspforce.planning.path.plan_along import plan_along, plan_fingers_along
    from graspforce.planning.plan import Plan, PlanCheck, PlanningStatistics
    from graspforce.planning.plan_files import load, save
    from graspforce.planning.progress import Progress, ProgressCallback
    from graspforce.planning.reference import joint_reference, object_reference
    from graspforce.planning.settings import PlanSettings
    from graspforce.planning.task import FingerTask, GraspTask, HandTask, IdealTask, ObjectTask, Task
    from graspforce.planning.trajectory import Trajectory

__all__ = [
    "UNBOUNDED",
    "AccelerationLimits",
    "CollisionSettings",
    "FingerTask",
    "FingersMove",
    "FreeMove",
    "GraspTask",
    "HandTask",
    "IdealTask",
    "JointPath",
    "Move",
    "ObjectPath",
    "ObjectTask",
    "Obstacle",
    "PathMove",
    "Plan",
    "PlanCheck",
    "PlanFailure",
    "PlanSettings",
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
    "load",
    "move_from_dict",
    "object_reference",
    "plan_along",
    "plan_fingers",
    "plan_fingers_along",
    "plan_fingers_through",
    "plan_free",
    "save",
]
