"""A control stream as the driver uses it: states out, commands in, and a motor torque in every period.

A stream is a state machine:

| state    | motor torque                | leaves the state when                                                   |
|----------|-----------------------------|-------------------------------------------------------------------------|
| opening  | none: `latest` returns None | the first good command arrives → running                                |
| running  | the server's                | the last good command is older than `validity` → lost                   |
| lost     | the watchdog's (`late`)     | a good command arrives → resuming                                       |
| resuming | rate-limited (`resuming`)   | the torque reaches the commands → running; commands stop again → lost   |
| closed   | none                        |                                                                         |

The age of a command counts from when its state was sent, on the client's clock (`graspforce.service.client.watchdog` has the
law). While no good command arrives, a thread opens the stream again every 50 ms. It sends the memory of the last good command,
so that the server continues from it. The thread does nothing if the driver has sent no states for a second.

The driver's loop calls `step`, or `publish` and `latest`. The newest command stays with the connection until the driver reads
it; its arrival wakes no Python thread. This module does not use the network: the client passes the connection in.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import msgspec
import numpy as np
import numpy.typing as npt

from graspforce.control import ContactChange, DesiredMotion, GraspState, check_joint_count
from graspforce.control.contacts.contact_conditions import ContactConditions, Mask, make_conditions
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import ErrorReply, InvalidInput, RequestRefused, ServiceError, ServiceTimeout, format_value
from graspforce.core.json_text import JsonRecord
from graspforce.estimation.measurement import Measurement
from graspforce.grasp.grasp import Grasp
from graspforce.service.client.replies import make_unreadable_error
from graspforce.service.client.stream_changes import StreamChanges, resumed_setup
from graspforce.service.client.watchdog import CommandMonitor, Watchdog
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import CommandRecord, RemoteCommand
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.stream_authentication import ownership_proof, read_key
from graspforce.service.wire.stream_state import StreamState

_RETRY_PERIOD = 0.05  # s, between attempts to open the stream again
_PAUSE_TIMEOUT = 1.0  # s, without states: the driver has paused
_BUSY_WAIT = 1e-3  # s, of waiting without sleep, because waking up takes tens of microseconds
_POLL_PERIOD = 1e-4  # s, between checks after that
_COMMAND_DECODERS: dict[str, Any] = {
    protocol.MSGPACK: msgspec.msgpack.Decoder(CommandRecord),
    protocol.JSON: msgspec.json.Decoder(CommandRecord),
}


StateInputs = tuple[GraspState | Measurement, DesiredMotion, npt.ArrayLike | None, ContactConditions | None]


class StreamConnection(Protocol):
    """Connection of a stream to its server. No method waits."""

    def send(self, payload: bytes) -> None:
        """Send a state."""

    def receive(self) -> tuple[bytes, str] | None:
        """Return the payload and encoding of the newest unread command, or None."""

    def authenticate(self, key: bytes) -> None:
        """Sign states and verify commands with the key of an opening."""

    def close(self) -> None:
        """Stop sending and receiving."""


class Stream:
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
        watchdog: motor torque while no commands arrive.
        codec: encoding of the states.
        timeout: how long `step` waits for the first command, s.
        query: function that sends a record to the stream's key and returns the answer.
        connect: function that returns the connection.

    Raises:
        ServiceError: the stream cannot be opened.
    """

    def __init__(
        self,
        id: str,
        setup: StreamSetup,
        *,
        watchdog: Watchdog,
        codec: str,
        timeout: float,
        query: Callable[[JsonRecord], JsonRecord],
        connect: Callable[[], StreamConnection],
    ) -> None:
        self.id, self.setup = id, setup
        self.last_error: ServiceError | None = None
        self._codec, self._timeout, self._query = codec, timeout, query
        self._hand, self._changes = setup.grasp.hand, StreamChanges(setup)
        limits = self._hand.torque_lower, self._hand.torque_upper
        step = setup.torque_step * 0.5 * (limits[1] - limits[0])  # N·m
        self._monitor = CommandMonitor(watchdog, setup.validity, *limits, step)
        self.sequence = 0
        self._state: GraspState | Measurement | None = None
        self._sent_time = -np.inf  # when the last state was sent, s
        self._last_command: RemoteCommand | None = None
        self._last_received = time.monotonic()  # when the last good command arrived, s
        self._closed, self._wake = threading.Event(), threading.Event()
        self._is_server_closing = False
        self._connection = connect()
        self._proof: JsonRecord = {}
        try:
            self._open(setup)
        except BaseException:
            self._connection.close()
            raise
        self._reconnect_thread = threading.Thread(target=self._reconnect, name=f"reconnect-{id}", daemon=True)
        self._reconnect_thread.start()

    def _open(self, setup: StreamSetup) -> None:
        """Open the stream at the server, and take the key of this opening."""
        answer = self._query({**setup.to_dict(), **self._proof})
        if setup.authenticated:
            try:
                key = read_key(answer.get("key"))
            except InvalidInput as error:
                raise make_unreadable_error(error) from None
            self._connection.authenticate(key)
            self._proof = {"proof": ownership_proof(key, self.id)}

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

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
            InvalidInput: another change is in progress, a finger that joins has a contact, no contact would be left, or the
                stream has sensors.
            UnknownName: no such finger, or a finger that lets go has no contact.
        """
        self._changes.request(change)

    def close(self) -> None:
        """Close the stream here and at the server. A second call does nothing."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._wake.set()
        self._reconnect_thread.join()
        with contextlib.suppress(ServiceError):  # a server that cannot be reached closes the stream when it is idle
            self._query({"close": True, **self._proof})
        self._connection.close()

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
        if self._last_command is None:
            self._wait_for_first_command(inputs)
        else:
            self._wait_for_command(self._send(*inputs), self.setup.settings.period if wait is None else wait)
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
        check_joint_count(self._hand, state.q, desired)
        if conditions is not None:
            conditions.check(self.grasp)
        wrench = None if external is None else arrays.check_array(external, "external", (6,))
        self.sequence += 1
        self._state, self._sent_time = state, time.monotonic()
        changes = self._changes
        message = StreamState(
            *(self.sequence, self._sent_time, state, desired, wrench, conditions),
            contacts=changes.pending,
            fingers=None if conditions is None else changes.fingers,
        )
        self._connection.send(message.encode(self._codec))
        return self.sequence

    def latest(self) -> RemoteCommand | None:
        """Return the newest command, or the watchdog's torque, without waiting.

        Call it once per period: each call advances the watchdog's rate limit by one step.

        Returns:
            The command, or None before the first.
        """
        self._read_newest()
        if self._last_command is None or self._state is None:
            return None
        output = self._monitor.torque(time.monotonic(), self._state.q, self._joint_rates())
        assert output is not None  # after the first good command
        warnings = self._last_command.warnings
        if output.late:
            reason = self.last_error or "no command arrived"
            warnings = (*warnings, f"{reason}: the watchdog is active, the last good command is {output.age:.3f} s old")
        return RemoteCommand(
            output.tau, warnings, output.age, output.late, output.resuming, self._last_command.record, self._last_command.grasp
        )

    def _joint_rates(self) -> Array:
        """Return the joint rates of the last state; the last estimated ones if they are not measured, rad/s."""
        assert self._state is not None  # after the first state
        if self._state.v is not None:
            return self._state.v
        estimate = None if self._last_command is None else self._last_command.estimate
        return np.zeros(self._hand.n) if estimate is None else np.array(estimate.velocity)

    def _wait_for_first_command(self, inputs: StateInputs) -> None:
        """Send a state repeatedly until the first good command: a command may get lost, or expire."""
        deadline = time.monotonic() + self._timeout
        while self._last_command is None:
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                raise ServiceTimeout(f"stream {self.id}: no command within {self._timeout:g} s")
            wait = min(remaining, max(self.setup.validity, _RETRY_PERIOD))
            self._wait_for_command(self._send(*inputs), wait)
            if self._last_command is None and self.last_error is not None:
                raise self.last_error

    def _wait_for_command(self, sequence: int, wait: float) -> None:
        """Wait for the command of a state, at most for a time in s. An error before the first good command ends the wait."""
        start = time.monotonic()
        while self._last_command is None or self._last_command.sequence != sequence:
            if self._read_newest():
                if self._last_command is None and self.last_error is not None:
                    return
                continue
            waited = time.monotonic() - start  # s
            if waited >= wait:
                return
            if waited < _BUSY_WAIT:
                os.sched_yield()
            else:
                time.sleep(min(_POLL_PERIOD, wait - waited))

    def _read_newest(self) -> bool:
        """Read the newest command; return True if there was one."""
        message = self._connection.receive()
        if message is not None:
            self._accept(*message)
        return message is not None

    def _accept(self, payload: bytes, encoding: str) -> None:
        """Store a command if it is good, or the error that arrived in its place."""
        try:
            record = _COMMAND_DECODERS[protocol.select_codec(encoding)].decode(payload)
            command = record.unpack(self._changes.grasp_of(record, self._state))
        except (msgspec.MsgspecError, ValueError, RecursionError):  # ValueError: arrays of wrong size
            self.last_error = _read_failure(payload, encoding)
            if isinstance(self.last_error, RequestRefused) and self.last_error.code == "closing":
                self._is_server_closing = True
                self._wake.set()
            self._changes.refuse(self.last_error)
            return
        # Ignore commands that the server marks as late, and commands that answer no state of this stream.
        if record.late or record.time is None or not record.time <= self._sent_time:
            return
        if len(command.tau) != self._hand.n or not math.isfinite(sum(command.tau.tolist())):
            message = f"the server's torque is invalid: {format_value(command.tau)}"
            self.last_error = ErrorReply("internal", message, "torque")
            return
        now = time.monotonic()
        if self._monitor.accept(command.tau, record.time, now):
            self._last_command, self._last_received, self.last_error = command, now, None
            self._changes.accept(command)

    def _reconnect(self) -> None:
        """Open the stream again while the driver sends states and no good command arrives, or when the server closes."""
        patience = max(self.setup.validity, 2.0 * _RETRY_PERIOD)  # s
        while not self._closed.is_set():
            self._wake.wait(_RETRY_PERIOD)
            self._wake.clear()
            now = time.monotonic()
            is_running = now - self._last_received < patience and not self._is_server_closing
            if self._closed.is_set() or now - self._sent_time > _PAUSE_TIMEOUT or is_running:
                continue
            self._is_server_closing = False
            setup = self.setup if self._last_command is None else resumed_setup(self.setup, self._last_command)
            try:
                try:
                    self._open(setup)
                except ErrorReply:  # the server may reject the memory: start without it
                    has_changed = setup.change_number > self.setup.change_number
                    without = dataclasses.replace(setup, memory=None) if has_changed else self.setup
                    self._open(without)
            except ServiceError as error:
                self.last_error = error


def _read_failure(payload: bytes, encoding: str) -> ServiceError:
    """Return the exception of a message that is not a command."""
    try:
        return protocol.read_error(protocol.decode(payload, protocol.select_codec(encoding)))
    except InvalidInput as error:
        return make_unreadable_error(error)
