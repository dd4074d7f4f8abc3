"""Control of a stream of the phases of a grasp."""

from __future__ import annotations

import math

from graspforce.control.phases.phase_controller import PhaseController
from graspforce.core.errors import InvalidInput
from graspforce.service.wire.phase_records import PhaseCommandRecord, PhaseState, PhaseStreamSetup


class PhaseControl:
    """The phase controller of a stream.

    Args:
        setup: fixed parameters of the stream.

    Raises:
        InvalidInput: no gains are stable with these sensors; names the field.
    """

    def __init__(self, setup: PhaseStreamSetup) -> None:
        self._controller = PhaseController(setup.plan, setup.phases, setup.sensors, setup.settings)
        self._has_drive, self._hand = not setup.hand.drives.is_ideal, setup.hand

    def decode(self, payload: bytes, codec: str) -> PhaseState:
        """Return a state.

        Args:
            payload: the encoded state.
            codec: its encoding.

        Raises:
            InvalidInput: as in `PhaseState.decode`.
        """
        return PhaseState.decode(self._hand, payload, codec)

    def step(self, state: PhaseState) -> PhaseCommandRecord:
        """Return the command for a measurement.

        Args:
            state: the state.

        Raises:
            InvalidInput: the measurement is earlier than the last one, lacks what the sensors measure, or has too large
                numbers.
        """
        if state.stop and not self._controller.is_over:
            self._controller.stop(state.stop)
        command = self._controller.step(state.measurement)
        if not math.isfinite(sum(command.tau.tolist())):
            raise InvalidInput("measurement", "too large numbers", "of a magnitude that gives finite torques")
        return PhaseCommandRecord.pack(command, self._has_drive)
