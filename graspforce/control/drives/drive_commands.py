"""Set-points of drives: the torques of a command, turned into what the actuators of the hand take.

With the joint torque tau that a command asks for, the joint rate v and the gear's efficiencies η and η_b, the motor must make

    m = tau/η while it drives the joint (tau v > 0),    m = tau η_b while the joint drives it.

At rest the friction of the gear holds joint torques from η m to m/η_b. Their mean is tau for m = 2 tau/(η + 1/η_b). In
general, smoothly through zero,

    m = tau/(c − d tanh(v sign(tau)/ε)),    c = (η + 1/η_b)/2,    d = (1/η_b − η)/2.

The drive then takes, by its mode,

- ``torque``: m;
- ``current``: i = m/k;
- ``impedance``: the joint's position and rate with stiffness and damping, and m as the torque that it adds;
- ``position``: q_set = q + (m + D v)/K, since the servo makes K (q_set − q) − D v;
- ``position_with_current_limit``: the limit |m|/k, with a position so far ahead that the servo reaches it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import make_unchecked
from graspforce.hand.descriptions.drive_description import DRIVE_MODES, DriveMode
from graspforce.hand.drives.drive import CURRENT_MODES, DIRECTION_RATE, POSITION_MODES
from graspforce.hand.hand import Hand

_OVERDRIVE = 0.1  # of the torque by which a servo's position exceeds the one that reaches the current limit


@dataclass(frozen=True, eq=False, slots=True)
class DriveCommand:
    """What the drives of n joints take for one period. A set-point that a drive's mode does not take is NaN.

    Attributes:
        joints: name of each actuated joint.
        modes: mode of each drive.
        torque: (n,) torques of modes ``torque`` and ``impedance``, N·m.
        current: (n,) motor currents of mode ``current``, A.
        position: (n,) set-points of the modes with positions, rad.
        velocity: (n,) rates of mode ``impedance``, rad/s.
        stiffness: (n,) stiffness of mode ``impedance``, N·m/rad.
        damping: (n,) damping of mode ``impedance``, N·m·s/rad.
        current_limit: (n,) largest currents of mode ``position_with_current_limit``, A.
        torque_error: (n,) largest difference between the joint torques and those of the command that the errors of the drives
            allow, N·m.
        limited: (n,) whether a set-point is at a limit of the drive, so that the torque is not reached.
    """

    joints: tuple[str, ...]
    modes: tuple[DriveMode, ...]
    torque: Array
    current: Array
    position: Array
    velocity: Array
    stiffness: Array
    damping: Array
    current_limit: Array
    torque_error: Array
    limited: npt.NDArray[np.bool_]

    def to_dict(self) -> JsonRecord:
        """Return a plain record. Set-points that no drive takes are absent, and single ones null."""
        record: JsonRecord = {"joints": list(self.joints), "modes": list(self.modes)}
        for name in _SET_POINTS:
            values = getattr(self, name)
            if not np.isnan(values).all():
                record[name] = [None if np.isnan(value) else value for value in values.tolist()]
        return {**record, "torque_error": self.torque_error.tolist(), "limited": self.limited.tolist()}

    @classmethod
    def from_dict(cls, record: object, field: str = "drive") -> DriveCommand:
        """Read set-points from a plain record.

        Args:
            record: as `to_dict` returns it.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=["joints", "modes", *_RESULTS], optional=_SET_POINTS)
        joints = [fields.check_text(name, f"{field}.joints") for name in fields.check_sequence(values["joints"], "joints")]
        modes = fields.check_sequence(values["modes"], f"{field}.modes", at_least=len(joints))
        limited = fields.check_sequence(values["limited"], f"{field}.limited", at_least=len(joints))
        n, numbers = len(joints), {}
        for name in _SET_POINTS:
            given = values.get(name)
            row = [None] * n if given is None else fields.check_sequence(given, f"{field}.{name}", at_least=n)
            known = arrays.check_array([0.0 if value is None else value for value in row], f"{field}.{name}", (n,))
            numbers[name] = np.where([value is None for value in row], np.nan, known)
        return cls(
            joints=tuple(joints),
            modes=tuple(fields.check_choice(mode, f"{field}.modes", DRIVE_MODES) for mode in modes),
            torque_error=arrays.check_array(values["torque_error"], f"{field}.torque_error", (n,), minimum=0.0),
            limited=np.array([fields.check_boolean(value, f"{field}.limited") for value in limited], dtype=np.bool_),
            **numbers,
        )


_SET_POINTS = ("torque", "current", "position", "velocity", "stiffness", "damping", "current_limit")
_RESULTS = ("torque_error", "limited")


class DriveMap:
    """Map of one hand from joint torques to set-points of its drives.

    Args:
        hand: the hand.
        position_error: largest error of the joint positions that the set-points start from, rad.
        period: time for which set-points are held, s, if the drive does not hold them longer.

    Attributes:
        has_losses: whether a gear passes different torques in its two directions.
        takes_rates: whether a servo damps the joint, so that its set-points depend on the joint's rate.
    """

    def __init__(self, hand: Hand, position_error: float = 0.0, period: float = 0.0) -> None:
        drives = hand.drives
        self._joints, self._modes = tuple(joint.name for joint in hand.joints), drives.modes
        self._k, self._K, self._D = (drives.values(name) for name in ("torque_constant", "stiffness", "damping"))
        self._gain, self._loss = drives.gear_gain, drives.gear_loss  # joint torque per motor torque
        self._torque_error, self._stiffness_error = drives.values("torque_error"), drives.values("stiffness_error")
        self._largest_current = drives.values("current_limit")
        self.has_losses = bool(self._loss.any())
        beyond = drives.values("beyond_limits")
        self._lower, self._upper = hand.q_lower - beyond, hand.q_upper + beyond
        self._takes_torque = drives.has_mode("torque", "impedance")
        self._takes_current, self._is_impedance = drives.has_mode("current"), drives.has_mode("impedance")
        self._takes_position, self._is_servo = drives.has_mode(*POSITION_MODES), drives.has_mode("position")
        self._is_limited_servo = drives.has_mode("position_with_current_limit")
        self._has_current = drives.has_mode(*CURRENT_MODES)
        self.takes_rates = bool((self._takes_position & (self._D > 0.0)).any())
        # largest torque per error of a servo's position, N·m/rad; a servo at its current limit has none
        self._servo_gain = np.where(self._is_limited_servo, 0.0, np.nan_to_num(self._K) * (1.0 + self._stiffness_error))
        resolution, backlash = drives.values("resolution"), drives.values("backlash")
        self._hold = np.where(self._takes_position, np.maximum(period, 1.0 / drives.values("rate")), 0.0)  # s
        self._position_error = np.where(self._takes_position, 0.5 * resolution + position_error, 0.0) + 0.5 * backlash  # rad
        self._step_error = self._step_torque_error(resolution)

    def _step_torque_error(self, resolution: Array) -> Array:
        """Return (n,) the torque of half a step of the set-points, of half the backlash and of the position error, N·m."""
        elastic = self._servo_gain * self._position_error  # N·m
        current = np.where(self._takes_current, np.nan_to_num(self._k) * 0.5 * resolution, 0.0)  # N·m
        direct = np.where(self._takes_torque & ~self._takes_position, 0.5 * resolution, 0.0)  # N·m
        return freeze(elastic + current + direct)

    def set_points(self, tau: Array, q: Array, v: Array, planned_v: Array | None = None) -> DriveCommand:
        """Return the set-points for joint torques.

        Args:
            tau: (n,) joint torques of a command, N·m.
            q: (n,) joint positions when they act, rad.
            v: (n,) joint rates then, rad/s. The damping of a servo acts on the difference of the true rate from v.
            planned_v: (n,) planned joint rates, which decide the direction of the gears without noise, rad/s. Default: v.
        """
        direction = np.tanh(np.sign(tau) * (v if planned_v is None else planned_v) / DIRECTION_RATE)
        m = tau / (self._gain - direction * self._loss)  # N·m
        limited = np.zeros(len(tau), dtype=np.bool_)
        i_max = self._largest_current
        current = m / self._k
        limited |= self._has_current & (np.abs(current) > i_max)
        current = np.clip(current, -i_max, i_max)  # A
        damping_torque = self._D * v  # N·m
        excess = np.where(self._is_limited_servo, (1.0 + _OVERDRIVE) / (1.0 - self._stiffness_error), 1.0)
        moved = self._hold * np.abs(v)  # rad, while the drive holds a set-point
        lead = np.where(self._is_limited_servo, np.sign(m) * (self._position_error + moved), 0.0)  # rad
        offset = np.where(self._is_impedance, 0.0, lead + (excess * m + damping_torque) / self._K)  # rad
        wanted = q + offset
        position = np.clip(wanted, self._lower, self._upper)  # rad
        reached = self._K * (position - q) - damping_torque  # N·m
        is_short = (position != wanted) & ~self._is_impedance & (np.abs(reached) < np.abs(m))
        limited |= self._takes_position & is_short

        def only(mask: npt.NDArray[np.bool_], values: Array) -> Array:
            return np.where(mask, values, np.nan)

        gear_error = np.abs(m) * self._loss * (1.0 - np.abs(direction))  # N·m
        elastic_error = np.where(self._is_servo, self._stiffness_error * (np.abs(m) + np.abs(damping_torque)), 0.0)  # N·m
        hold_error = self._servo_gain * moved  # N·m
        error = np.abs(tau) * self._torque_error + gear_error + elastic_error + hold_error + self._step_error  # N·m
        return make_unchecked(
            DriveCommand,
            joints=self._joints,
            modes=self._modes,
            torque=only(self._takes_torque, m),
            current=only(self._takes_current, current),
            position=only(self._takes_position, np.where(self._is_impedance, q, position)),
            velocity=only(self._is_impedance, v),
            stiffness=only(self._is_impedance, self._K),
            damping=only(self._is_impedance, self._D),
            current_limit=only(self._is_limited_servo, np.abs(current)),
            torque_error=error,
            limited=limited,
        )
