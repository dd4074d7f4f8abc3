"""Bound of the torque's step from command to command of a stream."""

from __future__ import annotations

import numpy as np

from graspforce.control.drives.drive_commands import DriveMap
from graspforce.core.arrays import Array
from graspforce.estimation.measurement import Measurement
from graspforce.grasp.grasp import Grasp
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


class TorqueStepLimit:
    """Limit of the torque's step between consecutive commands: on the straight line from the last torque to the new one.

    If the contact forces of both torques lie inside their friction cones, so do those in between, because cones are convex.

    Args:
        grasp: hand, object and contacts.
        fraction: largest change of a joint's torque between two commands, as a fraction of half its torque range.
    """

    def __init__(self, grasp: Grasp, fraction: float) -> None:
        self._step, self._drives = largest_step(grasp, fraction), DriveMap(grasp.hand)
        self._last: Array | None = None

    def apply(self, record: CommandRecord, state: StreamState) -> None:
        """Limit the torque of a command in place; a warning then names the remaining part of the step.

        Args:
            record: the command.
            state: the state that it answers.
        """
        tau = to_array(record.torque)
        if self._last is not None:
            change = tau - self._last  # N·m
            excess = float((np.abs(change) / self._step).max())
            if excess > 1.0:
                tau = self._last + change / excess
                record.torque = tau.tobytes() if isinstance(record.torque, bytes) else tau.tolist()
                record.warnings = (*record.warnings, f"torque step limited to 1/{excess:.3g} of the computed one")
                self._limit_drives(record, tau, state)
        self._last = tau

    def _limit_drives(self, record: CommandRecord, tau: Array, state: StreamState) -> None:
        """Compute the set-points of the drives for a limited torque."""
        if record.drive is None:
            return
        measured = state.state
        rates = np.zeros(len(tau)) if isinstance(measured, Measurement) and measured.v is None else np.asarray(measured.v)
        record.drive = self._drives.set_points(tau, np.asarray(measured.q), rates).to_dict()
