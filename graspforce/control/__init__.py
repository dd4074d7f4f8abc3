"""Control of a grasped object: the object controller with its settings and records, and joint-space control laws.

The controller from measurements, which needs SciPy, is loaded at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from graspforce.control.command import Command
from graspforce.control.contacts.contact_change import ContactChange
from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.control.contacts.feasible_twists import feasible_twists
from graspforce.control.controller_source import write_controller
from graspforce.control.friction.friction_compensation import FrictionSettings, friction_slip_margin
from graspforce.control.memory import ControlMemory
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.control.object_controller import ObjectController
from graspforce.control.sensor_gains import LoopMargins, LoopTargets
from graspforce.control.settings import ControlSettings, PoseGains, SensorSettings
from graspforce.control.state import (
    DesiredMotion,
    GraspMotion,
    GraspState,
    check_joint_count,
    desired_from_dict,
    object_motion,
)
from graspforce.control.uncertain_settings import settings_for_errors
from graspforce.core.lazy import lazy_exports

if TYPE_CHECKING:
    from graspforce.control.output_feedback import OutputFeedbackController
    from graspforce.control.output_feedback_law import OutputFeedbackLaw, OutputFeedbackMemory

__all__ = [
    "Command",
    "ContactChange",
    "ContactConditions",
    "ControlMemory",
    "ControlSettings",
    "DesiredMotion",
    "FrictionSettings",
    "GraspMotion",
    "GraspState",
    "LoopMargins",
    "LoopTargets",
    "ObjectControlLaw",
    "ObjectController",
    "OutputFeedbackController",
    "OutputFeedbackLaw",
    "OutputFeedbackMemory",
    "PoseGains",
    "SensorSettings",
    "check_joint_count",
    "desired_from_dict",
    "feasible_twists",
    "friction_slip_margin",
    "object_motion",
    "settings_for_errors",
    "write_controller",
]

_LAW = "graspforce.control.output_feedback_law"

__getattr__ = lazy_exports(
    __name__,
    {
        "OutputFeedbackController": "graspforce.control.output_feedback",
        "OutputFeedbackLaw": _LAW,
        "OutputFeedbackMemory": _LAW,
    },
)
