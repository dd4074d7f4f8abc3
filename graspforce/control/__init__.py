"""Control of what a hand holds: the object follows, by torques of motors whose fingers neither slip nor let go."""

from graspforce.control.command import Command
from graspforce.control.memory import ControlMemory
from graspforce.control.object_controller import ObjectController, ObjectLaw
from graspforce.control.settings import ControlSettings, PoseGains
from graspforce.control.state import Desired, GraspMotion, GraspState, body_of, fit

__all__ = [
    "Command",
    "ControlMemory",
    "ControlSettings",
    "Desired",
    "GraspMotion",
    "GraspState",
    "ObjectController",
    "ObjectLaw",
    "PoseGains",
    "body_of",
    "fit",
]
