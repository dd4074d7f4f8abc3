"""Numbers of one instant that the charts of a view show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.simulation.recordings.recording import Recording
from graspforce.simulation.recordings.recording_builder import ControllerCommand


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
    ) -> Readings:
        """Return the readings of a command.

        Args:
            t: time, s.
            command: the command.
            hand: the hand, for its torque limits.
            step_time: time that the controller took, ms.
            motions: name of the present motion of each finger; None if it is not known.
        """
        error = 1e3 * float(np.linalg.norm(command.error[:3]))
        use = torque_use(np.asarray(command.tau), hand.torque_lower, hand.torque_upper)
        return cls(t, np.asarray(command.slip_margin), use, error, step_time, command.warnings, motions=motions or {})

    @classmethod
    def of_recording(cls, recording: Recording) -> tuple[Readings, ...]:
        """Return the readings of each step of a recording.

        Args:
            recording: the recording.
        """
        errors = 1e3 * np.linalg.norm(recording.position_error, axis=1)  # mm
        use = torque_use(recording.tau, recording.torque_lower, recording.torque_upper)
        margins = recording.slip_margin
        return tuple(cls(float(t), margins[i], use[i], float(errors[i])) for i, t in enumerate(recording.t))


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
