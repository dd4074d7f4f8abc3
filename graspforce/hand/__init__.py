"""Hands: kinematics, dynamics, motors, description files, model checks, and the shipped models.

The names below load Pinocchio at first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from graspforce.core.lazy import lazy_exports

if TYPE_CHECKING:
    from graspforce.hand.actuation import Actuation
    from graspforce.hand.descriptions.description import shipped_hands
    from graspforce.hand.drives.drive import Drive, Drives
    from graspforce.hand.drives.joint_friction import JointFriction
    from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
    from graspforce.hand.kinematics.coordinates import Finger, JointInfo
    from graspforce.hand.kinematics.kinematic_tree import KinematicTree, Mesh
    from graspforce.hand.lint.findings import Finding
    from graspforce.hand.lint.lint_hand import lint_hand
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
        "Drive": "graspforce.hand.drives.drive",
        "Drives": "graspforce.hand.drives.drive",
        "Finding": "graspforce.hand.lint.findings",
        "Finger": "graspforce.hand.kinematics.coordinates",
        "GRAVITY_PALM_UP": "graspforce.hand.hand",
        "Hand": "graspforce.hand.hand",
        "JointFriction": "graspforce.hand.drives.joint_friction",
        "JointInfo": "graspforce.hand.kinematics.coordinates",
        "KinematicTree": "graspforce.hand.kinematics.kinematic_tree",
        "Mesh": "graspforce.hand.kinematics.kinematic_tree",
        "MotorModel": "graspforce.hand.motor",
        "MotorResponse": "graspforce.hand.motor",
        "lint_hand": "graspforce.hand.lint.lint_hand",
        "shipped_hands": "graspforce.hand.descriptions.description",
    },
)
