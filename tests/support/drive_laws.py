"""The laws of drives, written for one joint at a time: the joint torque that follows from a set-point."""

from __future__ import annotations

import math

from graspforce.control.drives.drive_commands import DriveCommand
from graspforce.hand.drives.drive import Drive


def joint_torque(drive: Drive, command: DriveCommand, i: int, q: float, v: float) -> float:
    """Return the torque at joint i, N·m, of a drive that may differ from the one that the command was made for."""
    k, K, D = drive.torque_constant, drive.stiffness, drive.damping
    match drive.mode:
        case "torque":
            motor = float(command.torque[i])
        case "current":
            motor = k * float(command.current[i])
        case "impedance":
            spring = float(command.stiffness[i]) * (float(command.position[i]) - q)
            damper = float(command.damping[i]) * (float(command.velocity[i]) - v)
            motor = float(command.torque[i]) + spring + damper
        case "position":
            motor = K * (float(command.position[i]) - q) - D * v
        case _:
            limit = k * float(command.current_limit[i])
            motor = min(max(K * (float(command.position[i]) - q) - D * v, -limit), limit)
    return motor * gear_factor(drive, motor, v)


def gear_factor(drive: Drive, motor: float, v: float) -> float:
    """Return the joint torque per motor torque; at rest the middle of what the friction of the gear holds."""
    if motor * v == 0.0:
        return 0.5 * (drive.efficiency + 1.0 / drive.backdriving_efficiency)
    return drive.efficiency if motor * v > 0.0 else 1.0 / drive.backdriving_efficiency


def perturbed(drive: Drive, torque: float, stiffness: float) -> Drive:
    """Return a drive whose constants differ by relative errors; damping differs as the stiffness does."""
    values = {name: getattr(drive, name) for name in drive.__dataclass_fields__}
    if drive.torque_constant is not None:
        values["torque_constant"] = drive.torque_constant * (1.0 + torque)
    if drive.stiffness is not None:
        values["stiffness"] = drive.stiffness * (1.0 + stiffness)
    return Drive(**{**values, "damping": drive.damping * (1.0 + stiffness)})


def is_fast(v: float, rate: float) -> bool:
    """Return whether the gear's direction is certain at a joint rate: tanh is 1 within rounding."""
    return math.tanh(abs(v) / rate) == 1.0
