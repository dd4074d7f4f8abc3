"""Control of a grasped object: the object controller with its settings and records, and joint-space control laws."""

from graspforce.control.command import Command
from graspforce.control.memory import ControlMemory
from graspforce.control.object_controller import ObjectControlLaw, ObjectController
from graspforce.control.settings import ControlSettings, PoseGains
from graspforce.control.state import (
    DesiredMotion,
    GraspMotion,
    GraspState,
    check_joint_count,
    desired_from_dict,
    object_motion,
)

__all__ = [
    "Command",
    "ControlMemory",
    "ControlSettings",
    "DesiredMotion",
    "GraspMotion",
    "GraspState",
    "ObjectControlLaw",
    "ObjectController",
    "PoseGains",
    "check_joint_count",
    "desired_from_dict",
    "object_motion",
]
