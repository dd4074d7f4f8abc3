"""Minimum-time moves of a held object, and of fingers alone."""

from __future__ import annotations

from graspforce.planning.along_path import plan_along
from graspforce.planning.desired import joint_reference, reference
from graspforce.planning.export import save
from graspforce.planning.fingers import plan_fingers
from graspforce.planning.free import plan_free
from graspforce.planning.free_program import ANYWHERE, Room
from graspforce.planning.move import FingersMove, FreeMove, Move, PathMove
from graspforce.planning.obstacles import Obstacle
from graspforce.planning.path import JointPath, ObjectPath, Screw, SplinePath, Straight
from graspforce.planning.plan import Check, Effort, Motion, Plan
from graspforce.planning.progress import Progress, Watch
from graspforce.planning.refusal import Refusal
from graspforce.planning.task import Task

__all__ = [
    "ANYWHERE",
    "Check",
    "Effort",
    "FingersMove",
    "FreeMove",
    "JointPath",
    "Motion",
    "Move",
    "ObjectPath",
    "Obstacle",
    "PathMove",
    "Plan",
    "Progress",
    "Refusal",
    "Room",
    "Screw",
    "SplinePath",
    "Straight",
    "Task",
    "Watch",
    "joint_reference",
    "plan_along",
    "plan_fingers",
    "plan_free",
    "reference",
    "save",
]
