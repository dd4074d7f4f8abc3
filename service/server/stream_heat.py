"""Temperatures of the motors in a stream, estimated from its commands or from measured currents."""

from __future__ import annotations

import numpy as np

from graspforce.estimation.measurement import Measurement
from graspforce.hand.hand import Hand
from graspforce.hand.heat import ThermalModel
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.wire.memory_records import to_array
from graspforce.service.wire.stream_state import StreamState

_INTERVAL = 0.1  # s, between two steps of the thermal model
_LONGEST_PAUSE = 60.0  # s: the last torque counts for a longer pause, but no longer


class StreamHeat:
    """Thermal model of the motors of a stream. The motors begin at the temperature of the air.

    Args:
        hand: hand whose drives have thermal data.
    """

    def __init__(self, hand: Hand) -> None:
        self._model = ThermalModel(hand.drives)
        self._temperatures = self._model.at_rest()
        self._energy, self._waited = np.zeros(hand.n), 0.0  # A² s, and s, since the last step of the model
        self._last: tuple[float, np.ndarray] | None = None  # time of the last state, s, and current from then on, A

    def apply(self, record: CommandRecord, state: StreamState) -> None:
        """Add the temperatures of windings to a command in place, and count its torques.

        Args:
            record: the command.
            state: the state that it answers.
        """
        if self._last is not None:
            dt = min(max(state.time - self._last[0], 0.0), _LONGEST_PAUSE)
            self._energy, self._waited = self._energy + dt * np.square(self._last[1]), self._waited + dt
        if self._waited >= _INTERVAL:
            current = np.sqrt(self._energy / self._waited)
            self._temperatures = self._model.step(self._temperatures, current, self._waited)
            self._energy, self._waited = np.zeros_like(self._energy), 0.0
        measured = state.state.current if isinstance(state.state, Measurement) else None
        current = self._model.currents(to_array(record.torque)) if measured is None else np.asarray(measured)
        self._last = state.time, current
        winding = self._temperatures.winding
        record.winding_temperature = winding.tobytes() if isinstance(record.torque, bytes) else winding.tolist()
