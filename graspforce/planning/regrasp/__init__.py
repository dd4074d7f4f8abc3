"""Regrasping: moves of a held object beyond the reach of one grasp, with fingers that step while the others hold.

`find_regrasp_start` finds a grasp to begin with, `plan_regrasp` plans object moves and finger steps, and `RegraspController`
executes them.
"""

from graspforce.planning.regrasp.controller import RegraspController, RegraspPhase
from graspforce.planning.regrasp.goal_paths import RegraspGoal, goal_from_steps, plan_regrasp_to
from graspforce.planning.regrasp.plan_regrasp import plan_regrasp
from graspforce.planning.regrasp.pose_path import PosePath
from graspforce.planning.regrasp.records import FingerStage, ObjectStage, RegraspPlan, RegraspSettings, RegraspTask
from graspforce.planning.regrasp.rolling_motion import HeldObject
from graspforce.planning.regrasp.search import RegraspProgress
from graspforce.planning.regrasp.start import StartOptions, find_regrasp_start

__all__ = [
    "FingerStage",
    "HeldObject",
    "ObjectStage",
    "PosePath",
    "RegraspController",
    "RegraspGoal",
    "RegraspPhase",
    "RegraspPlan",
    "RegraspProgress",
    "RegraspSettings",
    "RegraspTask",
    "StartOptions",
    "find_regrasp_start",
    "goal_from_steps",
    "plan_regrasp",
    "plan_regrasp_to",
]
