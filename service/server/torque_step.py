"""Bound of the torque's step from command to command of a stream."""

from __future__ import annotations

import numpy as np

from graspforce.control.drives.drive_commands import DriveMap
from graspforce.core.arrays import Array
from graspforce.core.compiled import native
from graspforce.estimation.measurement import Measurement
from graspforce.grasp.grasp import Grasp
from graspforce.service.wire.binary_command import AnyCommand
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.wire.memory_records import to_array
from graspforce.service.wire.stream_state import StreamState


def largest_step(grasp: Grasp, fraction: float) -> Array:
    """Return (n,) the largest change of each joint's torque between two commands, N·m; infinite without torque limits.

    Args:
        grasp: hand, object and contacts.
        fraction: the change as a fraction of half the torque range.
    """
    return fraction * 0.5 * (grasp.hand.torque_upper - grasp.hand.torque_lower)


def torque_step_warning(excess: float) -> str:
    """Return the warning of a limited torque step.

    Args:
        excess: the computed step over its bound.
    """
    return f"torque step limited to 1/{excess:.3g} of the computed one"


def _step_ratio(tau: Array | bytes, last: Array | bytes, step: Array) -> float:
    """Return the largest change of a torque over its largest allowed one."""
    if native is not None:
        return float(native.torque_step_ratio(tau, last, step))
    return float((np.abs(to_array(tau) - to_array(last)) / step).max())


class TorqueStepLimit:
    """Limit of the torque's step between consecutive commands: on the straight line from the last torque to the new one.

    If the contact forces of both torques lie inside their friction cones, so do those in between, because cones are convex.

    Attributes:
        largest: (n,) largest change of each joint's torque between two commands, N·m; infinite without torque limits.
        last: torques of the last command, or the bytes of their numbers, N·m; None before the first.

    Args:
        grasp: hand, object and contacts.
        fraction: largest change of a joint's torque between two commands, as a fraction of half its torque range.
    """

    def __init__(self, grasp: Grasp, fraction: float) -> None:
        self.largest, self._drives = largest_step(grasp, fraction), DriveMap(grasp.hand)
        self.last: Array | bytes | None = None

    def apply(self, record: AnyCommand, state: StreamState) -> None:
        """Limit the torque of a command in place; a warning then names the remaining part of the step.

        Args:
            record: the command.
            state: the state that it answers.
        """
        given = record.torque
        tau = to_array(given) if isinstance(given, list) else given
        if self.last is not None:
            excess = _step_ratio(tau, self.last, self.largest)
            if excess > 1.0:
                last = to_array(self.last)
                tau = last + (to_array(tau) - last) / excess
                record.torque = tau.tolist() if isinstance(given, list) else tau.tobytes()
                record.warnings = (*record.warnings, torque_step_warning(excess))
                if isinstance(record, CommandRecord):
                    self._limit_drives(record, tau, state)
        self.last = tau

    def _limit_drives(self, record: CommandRecord, tau: Array, state: StreamState) -> None:
        """Compute the set-points of the drives for a limited torque."""
        if record.drive is None:
            return
        measured = state.state
        rates = np.zeros(len(tau)) if isinstance(measured, Measurement) and measured.v is None else np.asarray(measured.v)
        record.drive = self._drives.set_points(tau, np.asarray(measured.q), rates).to_dict()
