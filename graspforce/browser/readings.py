"""Numbers of one instant that the charts of a view show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.hand.hand import Hand
from graspforce.hand.heat import ThermalModel
from graspforce.simulation.recordings.recording import Recording
from graspforce.simulation.recordings.recording_builder import ControllerCommand

_BLOCKS = 1000  # of a recording, for its temperatures


@dataclass(frozen=True, eq=False, slots=True)
class Readings:
    """Numbers of one instant.

    Attributes:
        t: time, s.
        slip_margin: (N,) slip margin of each contact, N.
        torque_use: (n,) torque of each motor over its limit in the same direction; 0 for a motor without limit.
        position_error: distance of the object from its desired position, mm; NaN in a plan.
        step_time: time that the controller took for its last step, ms; NaN if it was not measured.
        warnings: warnings of the controller.
        speed: of the object, mm/s; NaN if it was not measured.
        temperature: of the hottest winding, °C; NaN without thermal data.
        motions: name of the present motion of each finger; empty if it is not known.
        phase: name of the present phase of a grasp; empty without phases.
        normal_force: (N,) normal force of each contact, N; empty if it is not shown.
        joint_error: largest distance of a joint from its desired position, degrees; NaN without one.
        torque_error: largest distance of a contact torque from its desired value, N·m; NaN without one.
    """

    t: float
    slip_margin: Array
    torque_use: Array
    position_error: float
    step_time: float = np.nan
    warnings: tuple[str, ...] = ()
    speed: float = np.nan
    temperature: float = np.nan
    motions: Mapping[str, str] = field(default_factory=dict)
    phase: str = ""
    normal_force: Array = field(default_factory=lambda: freeze(np.zeros(0)))
    joint_error: float = np.nan
    torque_error: float = np.nan

    @property
    def text(self) -> str:
        """The time, the phase, and the errors that are known, in one line."""
        numbers = (
            ("position error", self.position_error, ".3f", " mm"),
            ("joint error", self.joint_error, ".2f", "°"),
            ("torque error", self.torque_error, ".4f", " N·m"),
        )
        known = [f"{name} {value:{form}}{unit}" for name, value, form, unit in numbers if not np.isnan(value)]
        return ", ".join([f"t = {self.t:.2f} s", *([self.phase] if self.phase else []), *known])

    @property
    def motion_text(self) -> str:
        """The present motions in one line; empty if they are not known."""
        return ", ".join(f"{finger}: {name}" for finger, name in self.motions.items())

    @classmethod
    def of_command(
        cls,
        t: float,
        command: ControllerCommand,
        hand: Hand,
        step_time: float = np.nan,
        motions: Mapping[str, str] | None = None,
        temperature: float = np.nan,
    ) -> Readings:
        """Return the readings of a command.

        Args:
            t: time, s.
            command: the command.
            hand: the hand, for its torque limits.
            step_time: time that the controller took, ms.
            motions: name of the present motion of each finger; None if it is not known.
            temperature: of the hottest winding, °C.
        """
        error = 1e3 * float(np.linalg.norm(command.error[:3]))
        use = torque_use(np.asarray(command.tau), hand.torque_lower, hand.torque_upper)
        margins, warnings = np.asarray(command.slip_margin), command.warnings
        return cls(t, margins, use, error, step_time, warnings, temperature=temperature, motions=motions or {})

    @classmethod
    def of_recording(cls, recording: Recording, hand: Hand | None = None) -> tuple[Readings, ...]:
        """Return the readings of each step of a recording.

        Args:
            recording: the recording.
            hand: the hand, for the temperatures of its windings, which begin at that of the air; None without them.
        """
        errors = 1e3 * np.linalg.norm(recording.position_error, axis=1)  # mm
        use = torque_use(recording.tau, recording.torque_lower, recording.torque_upper)
        margins = recording.slip_margin
        heat = np.full(len(errors), np.nan)
        if hand is not None and hand.drives.has_thermal_data:
            heat = winding_temperatures(hand, recording.t, recording.tau).max(axis=1)
        return tuple(
            cls(float(t), margins[i], use[i], float(errors[i]), temperature=float(heat[i])) for i, t in enumerate(recording.t)
        )


def winding_temperatures(hand: Hand, t: Array, tau: Array) -> Array:
    """Return the temperatures of the windings over a motion that begins at the temperature of the air, (M, n), °C.

    The thermal model advances by blocks of steps, with the root mean square of their currents.

    Args:
        hand: the hand, with thermal data.
        t: (M,) times, s.
        tau: (M, n) joint torques, N·m.
    """
    model, rows = ThermalModel.for_hand(hand), np.empty_like(tau)
    now, size = model.at_rest(), max(1, len(t) // _BLOCKS)
    for i in range(0, len(t), size):
        rows[i : i + size] = now.winding
        j = min(i + size, len(t) - 1)
        if j > i:
            current = model.currents(np.sqrt(np.mean(tau[i:j] ** 2, axis=0)))
            now = model.step(now, current, float(t[j] - t[i]))
    return rows


def torque_use(tau: Array, lower: Array, upper: Array) -> Array:
    """Return torques over their limits in the same direction; 0 where there is no limit, 1 where the limit is 0.

    Args:
        tau: (…, n) torques, N·m.
        lower: (n,) lower limits, N·m.
        upper: (n,) upper limits, N·m.
    """
    limit = np.where(tau >= 0.0, upper, lower)
    with np.errstate(divide="ignore", invalid="ignore"):
        use = np.abs(tau / limit)
    return np.where(tau == 0.0, 0.0, np.where(np.isfinite(limit), np.where(limit == 0.0, 1.0, use), 0.0))
