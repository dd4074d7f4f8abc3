"""A control stream as the driver uses it: states of a held object out, commands of an object controller in.

`graspforce.service.client.command_stream` has the state machine of all streams. While no good command arrives, a thread opens
the stream again. It sends the memory of the last good command, so that the server continues from it.

The driver's loop calls `step`, or `publish` and `latest`.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from graspforce.control import ContactChange, DesiredMotion, GraspState, check_joint_count
from graspforce.control.contacts.contact_conditions import ContactConditions, Mask, make_conditions
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import ServiceError
from graspforce.core.json_text import JsonRecord
from graspforce.estimation.measurement import Measurement
from graspforce.grasp.grasp import Grasp
from graspforce.service.client.command_stream import CommandStream, StreamLink
from graspforce.service.client.stream_changes import StreamChanges, resumed_setup
from graspforce.service.wire import protocol
from graspforce.service.wire.binary_command import read_binary_command
from graspforce.service.wire.binary_state import write_state
from graspforce.service.wire.command_records import CommandRecord, ReceivedCommand, RemoteCommand
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.stream_state import StreamState

_COMMAND_DECODERS: dict[str, Any] = {
    protocol.MSGPACK: msgspec.msgpack.Decoder(CommandRecord),
    protocol.JSON: msgspec.json.Decoder(CommandRecord),
}


StateInputs = tuple[GraspState | Measurement, DesiredMotion, npt.ArrayLike | None, ContactConditions | None]


class Stream(CommandStream[RemoteCommand]):
    """A control stream: the server's `ObjectController`, and a watchdog while its commands do not arrive.

    It has the interface of `ObjectController`: ``step(state, desired)`` returns a command. The states of a stream with sensors
    are measurements, as for `OutputFeedbackController`. `Client.open_stream` opens it. Use it from one thread, as a context
    manager or with `close`.

    Attributes:
        id: id of the stream, its key after ``streams/``.
        setup: fixed parameters: grasp, controller settings and validity.
        last_error: reason why the last command is missing; None if it arrived.
        sequence: number of the last state sent; 0 before the first.

    Args:
        id: id of the stream.
        setup: fixed parameters.
        link: watchdog, encoding and connection.

    Raises:
        ServiceError: the stream cannot be opened.
    """

    def __init__(self, id: str, setup: StreamSetup, link: StreamLink) -> None:
        self.setup, self._changes = setup, StreamChanges(setup)
        self._state: GraspState | Measurement | None = None
        super().__init__(id, setup, link)

    @property
    def grasp(self) -> Grasp:
        """The present grasp: that of the last command, or of the setup until contacts change."""
        return self._changes.grasp

    @property
    def is_changing(self) -> bool:
        """Whether contacts let go or join, or a change waits for the server."""
        return self._changes.is_changing

    @property
    def change_error(self) -> ServiceError | None:
        """Reason why the server refused the last change of contacts; None if it did not."""
        return self._changes.error

    def change_contacts(self, change: ContactChange) -> None:
        """Change the contacts from one of the next states on, as `ObjectController.change_contacts` does.

        Each state carries the change until a command acknowledges it, so that the change begins once even if messages get
        lost. `grasp` follows the commands, and `is_changing` is false when the change is over.

        Args:
            change: fingers that let go, and contacts of fingers that join. These fingertips are at their contacts.

        Raises:
            InvalidInput: another change is in progress, a finger that joins has a contact, or no contact would be left.
            UnknownName: no such finger, or a finger that lets go has no contact.
        """
        self._changes.request(change)

    def step(
        self,
        state: GraspState | Measurement,
        desired: DesiredMotion,
        external: npt.ArrayLike | None = None,
        *,
        slipping: Sequence[bool] | Mask | None = None,
        friction: npt.ArrayLike | None = None,
        lost: Sequence[str] = (),
        wait: float | None = None,
    ) -> RemoteCommand:
        """Send a state and wait for its command. Returns the watchdog's torque if the command does not arrive in time.

        The wait is busy for the first millisecond: this uses one processor and avoids the delay of waking up.

        Args:
            state: state of hand and object, or a measurement if the stream has sensors.
            desired: desired motion of the object; in a `GraspMotion` also of the joints.
            external: (6,) estimated wrench on the object apart from gravity and finger forces, about O's origin, in O, N and
                N·m. None for zero.
            slipping: (N,) whether each contact slips now; as in `ObjectController.step`.
            friction: (N,) lower bounds of the friction coefficients in this period; as in `ObjectController.step`.
            lost: names of fingers whose drives are off; as in `ObjectController.step`.
            wait: how long to wait, s; by default one period. The first command of a stream has the client's timeout.

        Returns:
            The command: torque, forces and margins. `late` and `resuming` state its phase.

        Raises:
            InvalidInput: the state does not fit the hand.
            UnknownName: a lost finger is not one of the grasp.
            ServiceTimeout: the first command did not arrive.
            ErrorReply: the server rejected the first state.
        """
        inputs = state, desired, external, make_conditions(slipping, friction, lost)
        self._exchange(lambda: self._send(*inputs), self.setup.settings.period if wait is None else wait)
        command = self.latest()
        assert command is not None  # after the first good command
        return command

    def publish(self, state: GraspState | Measurement, desired: DesiredMotion, external: npt.ArrayLike | None = None) -> int:
        """Send a state without waiting.

        Args:
            state: as in `step`.
            desired: as in `step`.
            external: as in `step`.

        Returns:
            The sequence number of the state; its command repeats it.

        Raises:
            InvalidInput: the state does not fit the hand.
        """
        return self._send(state, desired, external, None)

    def _send(
        self,
        state: GraspState | Measurement,
        desired: DesiredMotion,
        external: npt.ArrayLike | None,
        conditions: ContactConditions | None,
    ) -> int:
        """Send a state, and return its sequence number."""
        if conditions is None and self._send_quickly(state, desired, external):
            return self.sequence
        check_joint_count(self._hand, state.q, desired)
        if conditions is not None:
            conditions.check(self.grasp)
        wrench = None if external is None else arrays.check_array(external, "external", (6,))
        sequence, sent_time = self._next_sequence()
        self._state, changes = state, self._changes
        message = StreamState(
            *(sequence, sent_time, state, desired, wrench, conditions),
            contacts=changes.pending,
            fingers=None if conditions is None else changes.fingers,
        )
        self._connection.send(message.encode(self._codec, binary=True))
        return sequence

    def _send_quickly(self, state: GraspState | Measurement, desired: DesiredMotion, external: npt.ArrayLike | None) -> bool:
        """Send a state that has only the usual parts; otherwise return False."""
        if not isinstance(state, GraspState) or self._changes.pending is not None or self._codec != protocol.MSGPACK:
            return False
        wrench = None if external is None else arrays.check_array(external, "external", (6,))
        sequence, sent_time = self.sequence + 1, time.monotonic()
        payload = write_state(self._hand.n, sequence, sent_time, state, desired, wrench)
        if payload is None:
            return False
        self.sequence, self._sent_time, self._state = sequence, sent_time, state
        self._connection.send(payload)
        return True

    def latest(self) -> RemoteCommand | None:
        """Return the newest command, or the watchdog's torque, without waiting.

        Call it once per period: each call advances the watchdog's rate limit by one step.

        Returns:
            The command, or None before the first.
        """
        self._read_newest()
        if self._last_command is None or self._state is None:
            return None
        output = self._motor_torque(self._state.q, self._joint_rates())
        warnings = (*self._last_command.warnings, *self._late_warning(output))
        return RemoteCommand(
            output.tau, warnings, output.age, output.late, output.resuming, self._last_command.message, self._last_command.grasp
        )

    def _joint_rates(self) -> Array:
        """Return the joint rates of the last state; the last estimated ones if they are not measured, rad/s."""
        assert self._state is not None  # after the first state
        if self._state.v is not None:
            return self._state.v
        estimate = None if self._last_command is None else self._last_command.estimate
        return np.zeros(self._hand.n) if estimate is None else np.array(estimate.velocity)

    def _decode(self, payload: bytes, codec: str) -> RemoteCommand:
        found = read_binary_command(payload, self._changes.grasp) if codec == protocol.MSGPACK else None
        if found is not None:
            return found
        record: CommandRecord = _COMMAND_DECODERS[codec].decode(payload)
        return record.unpack(self._changes.grasp_of(record, self._state))

    def _facts(self, command: RemoteCommand) -> ReceivedCommand:
        return command.message

    def _largest_step(self) -> Array:
        hand = self.setup.hand
        return np.asarray(self.setup.torque_step * 0.5 * (hand.torque_upper - hand.torque_lower))

    def _take(self, command: RemoteCommand) -> None:
        self._changes.accept(command)

    def _take_error(self, error: ServiceError) -> None:
        self._changes.refuse(error)

    def _setups_to_continue(self) -> list[JsonRecord]:
        """Return the setup with the memory of the last command, then the one without it."""
        if self._last_command is None:
            return [self.setup.to_dict()]
        setup = resumed_setup(self.setup, self._last_command)
        has_changed = setup.change_number > self.setup.change_number
        without = dataclasses.replace(setup, memory=None) if has_changed else self.setup
        return [setup.to_dict(), without.to_dict()]
