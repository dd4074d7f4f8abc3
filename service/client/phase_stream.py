"""A stream of the phases of a grasp as the driver uses it: measurements out, torques and motions of the base in.

A stream of phases does not continue after an interruption. If commands are late, the watchdog takes over, the base brakes, and
every later state asks the server to stop the cycle with the safe stop of its phase. The base then stays where it stopped.
"""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import msgspec

from graspforce.control.phases.cycle_plan import BaseMotion, braked_motion
from graspforce.core.errors import InvalidInput
from graspforce.estimation.measurement import Measurement
from graspforce.service.client.command_stream import CommandStream, StreamLink
from graspforce.service.wire import protocol
from graspforce.service.wire.phase_records import PhaseCommandRecord, PhaseState, PhaseStreamSetup, RemotePhaseCommand

_DECELERATION = 1.0  # m/s², of the base while commands are late
LATE_COMMANDS = "commands were late"
_DECODERS: dict[str, Any] = {
    protocol.MSGPACK: msgspec.msgpack.Decoder(PhaseCommandRecord),
    protocol.JSON: msgspec.json.Decoder(PhaseCommandRecord),
}


class PhaseStream(CommandStream[RemotePhaseCommand]):
    """A stream of phases: the server's `PhaseController`, and a watchdog while its commands do not arrive.

    `Client.open_phase_stream` opens it. Use it from one thread, as a context manager or with `close`.

    Attributes:
        setup: fixed parameters: plan, settings and validity.

    Args:
        id: id of the stream.
        setup: fixed parameters.
        link: watchdog, encoding and connection.

    Raises:
        ServiceError: the stream cannot be opened.
    """

    def __init__(self, id: str, setup: PhaseStreamSetup, link: StreamLink) -> None:
        self.setup = setup
        self._measurement: Measurement | None = None
        self._stop = ""
        self._braking: tuple[BaseMotion, float] | None = None  # motion of the base at the loss of commands, and its time, s
        super().__init__(id, setup, link)

    def step(self, measurement: Measurement, *, wait: float | None = None) -> RemotePhaseCommand:
        """Send a measurement and wait for its command. Returns the watchdog's torque if it does not arrive in time.

        Args:
            measurement: the newest measurement.
            wait: how long to wait, s; by default one period. The first command of a stream has the client's timeout.

        Raises:
            InvalidInput: the measurement does not fit the hand.
            ServiceTimeout: the first command did not arrive.
            ErrorReply: the server rejected the first measurement.
        """
        self._exchange(lambda: self.publish(measurement), self.setup.period if wait is None else wait)
        command = self.latest()
        assert command is not None  # after the first good command
        return command

    def publish(self, measurement: Measurement) -> int:
        """Send a measurement without waiting, and return the sequence number of the state.

        Args:
            measurement: the newest measurement.

        Raises:
            InvalidInput: the measurement does not fit the hand.
        """
        if len(measurement.q) != self._hand.n:
            allowed = f"({self._hand.n},), one for each motor of {self._hand.name}"
            raise InvalidInput("measurement.q", measurement.q.shape, allowed)
        sequence, sent_time = self._next_sequence()
        self._measurement = measurement
        self._connection.send(PhaseState(sequence, sent_time, measurement, self._stop).encode(self._codec))
        return sequence

    def stop(self, reason: str = "stopped by the client") -> None:
        """Stop the cycle with the safe stop of the present phase, from the next measurement on.

        Args:
            reason: kept in the message of the commands; at most 200 characters.
        """
        self._stop = self._stop or reason

    def latest(self) -> RemotePhaseCommand | None:
        """Return the newest command, or the watchdog's torque, without waiting; None before the first command.

        Call it once per period: each call advances the watchdog's rate limit by one step.
        """
        self._read_newest()
        last, measurement = self._last_command, self._measurement
        if last is None or measurement is None:
            return None
        v = last.joints[1] if measurement.v is None else measurement.v
        output = self._motor_torque(measurement.q, v)
        now = time.monotonic()
        if output.late and self._braking is None:
            self._braking = last.base, now - output.age
            self.stop(LATE_COMMANDS)
        base = last.base
        if self._braking is not None:
            motion, start = self._braking
            base = braked_motion(motion, now - start, _DECELERATION)
        return dataclasses.replace(
            last,
            tau=output.tau,
            base=base,
            warnings=self._late_warning(output),
            age=output.age,
            late=output.late,
            resuming=output.resuming,
        )

    def _decode(self, payload: bytes, codec: str) -> RemotePhaseCommand:
        return RemotePhaseCommand.unpack(_DECODERS[codec].decode(payload), self._hand)
