"""A stream of a joint-space law as the driver uses it: measured and desired motions out, torques in."""

from __future__ import annotations

import dataclasses
from typing import Any

import msgspec
import numpy.typing as npt

from graspforce.control.joints.joint_command import JointMotion
from graspforce.core import arrays
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.service.client.command_stream import CommandStream, StreamLink
from graspforce.service.wire import protocol
from graspforce.service.wire.joint_records import FORCE, JointCommandRecord, JointState, JointStreamSetup, RemoteJointCommand

_DECODERS: dict[str, Any] = {
    protocol.MSGPACK: msgspec.msgpack.Decoder(JointCommandRecord),
    protocol.JSON: msgspec.json.Decoder(JointCommandRecord),
}


class JointStream(CommandStream[RemoteJointCommand]):
    """A stream of a joint-space law at the server, and a watchdog while its commands do not arrive.

    `Client.open_joint_stream` opens it. Use it from one thread, as a context manager or with `close`. After an interruption it
    continues with the integral of the last command.

    Attributes:
        setup: fixed parameters: law, gains and validity.

    Args:
        id: id of the stream.
        setup: fixed parameters.
        link: watchdog, encoding and connection.

    Raises:
        ServiceError: the stream cannot be opened.
    """

    def __init__(self, id: str, setup: JointStreamSetup, link: StreamLink) -> None:
        self.setup = setup
        self._measured: JointMotion | None = None
        super().__init__(id, setup, link)

    def step(self, measured: JointMotion, desired: JointMotion, *, wait: float | None = None) -> RemoteJointCommand:
        """Send a measured and a desired motion and wait for the command, as `JointController.step`.

        Args:
            measured: measured positions and rates.
            desired: desired positions, rates and accelerations.
            wait: how long to wait, s; by default one period. The first command of a stream has the client's timeout.

        Returns:
            The command; the watchdog's torque if it does not arrive in time.

        Raises:
            InvalidInput: a motion does not fit the hand, or the law is the force loop.
            ServiceTimeout: the first command did not arrive.
            ErrorReply: the server rejected the first state.
        """
        if self.setup.law == FORCE:
            raise InvalidInput("desired", "a motion", "absent: the force loop takes torques, see `step_forces`")
        arrays.check_array(desired.q, "desired.q", (self._hand.n,))
        return self._step(measured, wait, desired=desired)

    def step_forces(
        self,
        measured: JointMotion,
        tau_measured: npt.ArrayLike,
        tau_desired: npt.ArrayLike,
        *,
        wait: float | None = None,
    ) -> RemoteJointCommand:
        """Send measured and desired contact torques and wait for the command, as `ForceController.step`.

        Args:
            measured: measured positions and rates.
            tau_measured: (n,) measured contact torques Jᵀ f, N·m.
            tau_desired: (n,) desired contact torques Jᵀ f_d, N·m.
            wait: as in `step`.

        Raises:
            InvalidInput: a value does not fit the hand, or the law is no force loop.
            ServiceTimeout: the first command did not arrive.
            ErrorReply: the server rejected the first state.
        """
        if self.setup.law != FORCE:
            raise InvalidInput("tau_desired", "torques", f"absent: the law is {self.setup.law}, which takes motions")
        torque = arrays.check_array(tau_measured, "tau_measured", (self._hand.n,))
        torque_desired = arrays.check_array(tau_desired, "tau_desired", (self._hand.n,))
        return self._step(measured, wait, torque=torque, torque_desired=torque_desired)

    def latest(self) -> RemoteJointCommand | None:
        """Return the newest command, or the watchdog's torque, without waiting; None before the first command.

        Call it once per period: each call advances the watchdog's rate limit by one step.
        """
        self._read_newest()
        if self._last_command is None or self._measured is None:
            return None
        output = self._motor_torque(self._measured.q, self._measured.v)
        return dataclasses.replace(
            self._last_command,
            tau=output.tau,
            warnings=self._late_warning(output),
            age=output.age,
            late=output.late,
            resuming=output.resuming,
        )

    def _step(self, measured: JointMotion, wait: float | None, **targets: Any) -> RemoteJointCommand:
        """Send a state and return the command."""
        arrays.check_array(measured.q, "measured.q", (self._hand.n,))

        def send() -> int:
            sequence, sent_time = self._next_sequence()
            self._measured = measured
            self._connection.send(JointState(sequence, sent_time, measured, **targets).encode(self._codec))
            return sequence

        self._exchange(send, self.setup.period if wait is None else wait)
        command = self.latest()
        assert command is not None  # after the first good command
        return command

    def _decode(self, payload: bytes, codec: str) -> RemoteJointCommand:
        return RemoteJointCommand.unpack(_DECODERS[codec].decode(payload))

    def _setups_to_continue(self) -> list[JsonRecord]:
        """Return the setup with the integral of the last command."""
        if self._last_command is None:
            return [self.setup.to_dict()]
        return [dataclasses.replace(self.setup, integral=self._last_command.integral).to_dict()]
