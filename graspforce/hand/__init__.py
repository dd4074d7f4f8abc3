"""Hands: kinematics, dynamics, motors, description files, model checks, and the shipped models.

The names below load Pinocchio at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from graspforce.core.lazy import lazy_exports

if TYPE_CHECKING:
    from graspforce.hand.actuation import Actuation
    from graspforce.hand.coordinates import Finger, JointInfo
    from graspforce.hand.description import shipped_hands
    from graspforce.hand.drive import Drive, Drives
    from graspforce.hand.findings import Finding
    from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
    from graspforce.hand.joint_friction import JointFriction
    from graspforce.hand.kinematic_tree import KinematicTree, Mesh
    from graspforce.hand.lint import lint_hand
    from graspforce.hand.motor import MotorModel, MotorResponse

__all__ = [
    "GRAVITY_PALM_UP",
    "Actuation",
    "Drive",
    "Drives",
    "Finding",
    "Finger",
    "Hand",
    "JointFriction",
    "JointInfo",
    "KinematicTree",
    "Mesh",
    "MotorModel",
    "MotorResponse",
    "lint_hand",
    "shipped_hands",
]

__getattr__ = lazy_exports(
    __name__,
    {
        "Actuation": "graspforce.hand.actuation",
        "Drive": "graspforce.hand.drive",
        "Drives": "graspforce.hand.drive",
        "Finding": "graspforce.hand.findings",
        "Finger": "graspforce.hand.coordinates",
        "GRAVITY_PALM_UP": "graspforce.hand.hand",
        "Hand": "graspforce.hand.hand",
        "JointFriction": "graspforce.hand.joint_friction",
        "JointInfo": "graspforce.hand.coordinates",
        "KinematicTree": "graspforce.hand.kinematic_tree",
        "Mesh": "graspforce.hand.kinematic_tree",
        "MotorModel": "graspforce.hand.motor",
        "MotorResponse": "graspforce.hand.motor",
        "lint_hand": "graspforce.hand.lint",
        "shipped_hands": "graspforce.hand.description",
    },
)
