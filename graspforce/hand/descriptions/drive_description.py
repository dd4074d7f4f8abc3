"""Drives in a hand's description file: what the actuators take, and how their torque follows from it."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

DriveMode = Literal["torque", "current", "impedance", "position", "position_with_current_limit"]
DRIVE_MODES: tuple[DriveMode, ...] = ("torque", "current", "impedance", "position", "position_with_current_limit")

Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Efficiency = Annotated[float, Meta(gt=0, le=1)]
Fraction = Annotated[float, Meta(ge=0, lt=1)]


class ThermalDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The heat path of a motor, as manufacturers of motors specify it: winding, housing, ambient air.

    Attributes:
        winding_resistance: thermal resistance from the winding to the housing, K/W.
        winding_time_constant: thermal time constant of the winding, s.
        housing_resistance: thermal resistance from the housing to the ambient air, K/W.
        housing_time_constant: thermal time constant of the motor, s.
        largest_temperature: largest permissible temperature of the winding, °C.
        source: where the numbers come from.
    """

    winding_resistance: Positive
    winding_time_constant: Positive
    housing_resistance: Positive
    housing_time_constant: Positive
    largest_temperature: Positive
    source: str


class DriveDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The drive of each actuated joint whose name matches a pattern. The gear ratio is that of the joint's motor.

    Attributes:
        joints: shell patterns of joint names, such as ``*_joint_1``.
        mode: what the drive takes. ``torque``: a joint torque. ``current``: a motor current. ``impedance``: position, rate,
            stiffness, damping and a torque, which it adds. ``position``: a position, which its servo holds like a spring.
            ``position_with_current_limit``: a position and a largest current.
        source: where the numbers come from.
        torque_constant: torque per current at the rotor, N·m/A. Required for modes with a current.
        efficiency: fraction of the power that the gear passes from the motor to the joint.
        backdriving_efficiency: fraction that it passes from the joint to the motor; null for the same fraction.
        stiffness: joint torque per position error of the servo, N·m/rad. Required for modes with a position.
        damping: joint torque per joint rate of the servo, N·m·s/rad.
        current_limit: largest current of the motor, A; null for no limit other than the motor's torque.
        torque_error: largest relative error of the torque, such as that of the torque constant.
        stiffness_error: largest relative error of `stiffness` and `damping`.
        resolution: step of the set-point, in rad, A or N·m.
        rate: set-points that the drive takes per second, Hz; null for every one.
        delay: time from a set-point to its effect, s.
        backlash: play of the gear at the joint, rad.
        beyond_limits: how far beyond the joint's limits the drive takes positions, rad. A servo makes its torque there, too.
        resistance: of the winding at 25 °C, Ω.
        thermal: heat path of the motor; null if it is unknown.
    """

    joints: tuple[str, ...]
    mode: DriveMode
    source: str
    torque_constant: Positive | None = None
    efficiency: Efficiency = 1.0
    backdriving_efficiency: Efficiency | None = None
    stiffness: Positive | None = None
    damping: NonNegative = 0.0
    current_limit: Positive | None = None
    torque_error: Fraction = 0.0
    stiffness_error: Fraction = 0.0
    resolution: NonNegative = 0.0
    rate: Positive | None = None
    delay: NonNegative = 0.0
    backlash: NonNegative = 0.0
    beyond_limits: NonNegative = 0.0
    resistance: Positive | None = None
    thermal: ThermalDescription | None = None
