"""Drives of a hand's actuated joints, with their constants at the joints.

With the torque constant K_t at the rotor and the gear ratio N, a current i makes the torque k i before the losses of the gear,
k = K_t N. The servo of a drive that takes positions makes K (q_set − q) − D v at the joint, where v is the joint rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from functools import cached_property

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, ModelError
from graspforce.core.json_text import JsonRecord
from graspforce.hand.descriptions.drive_description import DRIVE_MODES, DriveDescription, DriveMode, ThermalDescription

CURRENT_MODES: tuple[DriveMode, ...] = ("current", "position_with_current_limit")
POSITION_MODES: tuple[DriveMode, ...] = ("impedance", "position", "position_with_current_limit")
DIRECTION_RATE = 0.02  # rad/s: the gear's direction is blended over about this joint rate
WINDING_REFERENCE = 25.0  # °C, at which `resistance` is given


@dataclass(frozen=True, slots=True)
class Drive:
    """The drive of one actuated joint. The defaults are those of an ideal drive that takes torques.

    Attributes:
        mode: what the drive takes.
        torque_constant: k, joint torque per current before the losses of the gear, N·m/A; None if it is unknown.
        efficiency: η, fraction of the power that the gear passes from the motor to the joint, in (0, 1].
        backdriving_efficiency: η_b, fraction that it passes from the joint to the motor, in (0, 1].
        stiffness: K of the servo at the joint, N·m/rad; None for drives without positions.
        damping: D of the servo at the joint, N·m·s/rad.
        current_limit: largest current, A; infinite without a limit.
        torque_error: largest relative error of the torque.
        stiffness_error: largest relative error of `stiffness` and `damping`.
        resolution: step of the set-point, in rad, A or N·m.
        rate: set-points that the drive takes per second, Hz; infinite for every one.
        delay: time from a set-point to its effect, s.
        backlash: play of the gear at the joint, rad.
        beyond_limits: how far beyond the joint's limits the drive takes positions, rad.
        resistance: of the winding at 25 °C, Ω; None if it is unknown.
        thermal: heat path of the motor; None if it is unknown.
        source: where the numbers come from; empty for the ideal drive.
    """

    mode: DriveMode = "torque"
    torque_constant: float | None = None
    efficiency: float = 1.0
    backdriving_efficiency: float = 1.0
    stiffness: float | None = None
    damping: float = 0.0
    current_limit: float = np.inf
    torque_error: float = 0.0
    stiffness_error: float = 0.0
    resolution: float = 0.0
    rate: float = np.inf
    delay: float = 0.0
    backlash: float = 0.0
    beyond_limits: float = 0.0
    resistance: float | None = None
    thermal: ThermalDescription | None = None
    source: str = ""

    def __post_init__(self) -> None:
        if self.mode not in DRIVE_MODES:
            raise InvalidInput("mode", self.mode, f"one of {', '.join(DRIVE_MODES)}")
        if self.mode in CURRENT_MODES and self.torque_constant is None:
            raise InvalidInput("torque_constant", None, f"a number above 0: the mode {self.mode} needs it")
        if self.mode in POSITION_MODES and self.stiffness is None:
            raise InvalidInput("stiffness", None, f"a number above 0: the mode {self.mode} needs it")

    @classmethod
    def from_description(cls, entry: DriveDescription, gear_ratio: float) -> Drive:
        """Return the drive of a joint.

        Args:
            entry: the drive in the hand's description.
            gear_ratio: N, turns of the rotor per turn of the joint.

        Raises:
            InvalidInput: the mode needs a constant that is missing.
        """
        constant = None if entry.torque_constant is None else entry.torque_constant * gear_ratio
        backdriving = entry.efficiency if entry.backdriving_efficiency is None else entry.backdriving_efficiency
        return cls(
            mode=entry.mode,
            torque_constant=constant,
            efficiency=entry.efficiency,
            backdriving_efficiency=backdriving,
            stiffness=entry.stiffness,
            damping=entry.damping,
            current_limit=np.inf if entry.current_limit is None else entry.current_limit,
            torque_error=entry.torque_error,
            stiffness_error=entry.stiffness_error,
            resolution=entry.resolution,
            rate=np.inf if entry.rate is None else entry.rate,
            delay=entry.delay,
            backlash=entry.backlash,
            beyond_limits=entry.beyond_limits,
            resistance=entry.resistance,
            thermal=entry.thermal,
            source=entry.source,
        )

    @property
    def largest_torque(self) -> float:
        """Joint torque at the current limit while the motor drives, η k i, N·m; infinite without a limit."""
        if self.torque_constant is None:
            return np.inf
        return self.efficiency * self.torque_constant * self.current_limit


@dataclass(frozen=True, eq=False)
class Drives:
    """The drives of a hand's n actuated joints.

    Args:
        joints: one drive for each actuated joint, in their order.
    """

    joints: tuple[Drive, ...]

    @classmethod
    def ideal(cls, n: int) -> Drives:
        """Return drives that take torques and apply them exactly.

        Args:
            n: number of actuated joints.
        """
        return cls((Drive(),) * n)

    def __len__(self) -> int:
        return len(self.joints)

    @cached_property
    def is_ideal(self) -> bool:
        """Whether every drive takes torques and has no error that the description states."""
        return all(replace(drive, source="") == Drive() for drive in self.joints)

    @cached_property
    def has_thermal_data(self) -> bool:
        """Whether the heat of every motor is known: its torque constant, resistance and heat path."""
        return all(None not in (drive.torque_constant, drive.resistance, drive.thermal) for drive in self.joints)

    @cached_property
    def modes(self) -> tuple[DriveMode, ...]:
        """Mode of each drive."""
        return tuple(drive.mode for drive in self.joints)

    @cached_property
    def delay(self) -> float:
        """Longest time from a set-point to its effect, s."""
        return max(drive.delay for drive in self.joints)

    @cached_property
    def longest_hold(self) -> float:
        """Longest time between two set-points that a drive takes, s; 0 if each drive takes every set-point."""
        return 1.0 / min(drive.rate for drive in self.joints)

    @cached_property
    def gear_gain(self) -> Array:
        """Joint torque per motor torque, the mean of both directions of the gears, (η + 1/η_b)/2, (n,)."""
        return freeze(0.5 * (self.values("efficiency") + 1.0 / self.values("backdriving_efficiency")))

    @cached_property
    def gear_loss(self) -> Array:
        """Half of the difference between both directions, (1/η_b − η)/2, (n,): the friction of the gears per motor torque."""
        return freeze(0.5 * (1.0 / self.values("backdriving_efficiency") - self.values("efficiency")))

    def has_mode(self, *modes: DriveMode) -> npt.NDArray[np.bool_]:
        """Return (n,) whether each drive has one of some modes.

        Args:
            *modes: the modes.
        """
        return np.array([mode in modes for mode in self.modes], dtype=np.bool_)

    def values(self, name: str) -> Array:
        """Return one quantity of all drives, (n,); NaN where it is unknown.

        Args:
            name: name of a number of `Drive`, such as "stiffness".
        """
        return freeze([np.nan if getattr(drive, name) is None else getattr(drive, name) for drive in self.joints])

    def to_list(self) -> list[JsonRecord]:
        """Return a plain record of each drive, without the numbers that are infinite or unknown."""
        return [_to_dict(drive) for drive in self.joints]


def _to_dict(drive: Drive) -> JsonRecord:
    """Return a plain record of a drive."""
    record: JsonRecord = {}
    for each in fields(drive):
        value = getattr(drive, each.name)
        if isinstance(value, ThermalDescription):
            value = {name: getattr(value, name) for name in value.__struct_fields__}
        if value is not None and value != np.inf:
            record[each.name] = value
    return record


def resolve_drives(described: Sequence[DriveDescription], gear_ratios: Mapping[str, float], file: str) -> Drives:
    """Return the drives of a hand's actuated joints. Joints that match no entry have ideal drives that take torques.

    Args:
        described: entries of the description.
        gear_ratios: turns of the rotor per turn of each actuated joint, by name.
        file: name of the description, for error messages.

    Raises:
        ModelError: a joint matches two entries, an entry matches no joint, or a mode lacks a constant that it needs.
    """
    for entry in described:
        if not any(_matches(entry, name) for name in gear_ratios):
            patterns, names = ", ".join(entry.joints), ", ".join(gear_ratios)
            raise ModelError(f"{file}: the drive of {patterns} matches no actuated joint; these are {names}")
    drives = []
    for name, gear_ratio in gear_ratios.items():
        entries = [entry for entry in described if _matches(entry, name)]
        if len(entries) > 1:
            raise ModelError(f"{file}: joint {name} must match at most one drive, not {len(entries)}")
        try:
            drives.append(Drive.from_description(entries[0], gear_ratio) if entries else Drive())
        except InvalidInput as error:
            raise ModelError(f"{file}: drive of joint {name}: {error}") from None
    return Drives(tuple(drives))


def _matches(entry: DriveDescription, joint: str) -> bool:
    """Return whether a joint's name matches one of the patterns of a drive."""
    return any(fnmatchcase(joint, pattern) for pattern in entry.joints)
