"""A control stream as a driver holds it: states out, commands in, and a torque at all times. No network here.

The driver's own loop calls `step`, or `publish` and `latest`. One other thread touches a stream: a keeper, which opens it again
while nothing comes. The newest command lies with the link until the driver looks: what comes wakes no thread of Python's.
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import math
import os
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import msgspec
import numpy as np

from graspforce.control import DesiredMotion, GraspState, check_joint_count
from graspforce.core import arrays
from graspforce.core.errors import ErrorReply, InvalidInput, ServiceError, ServiceTimeout, format_value
from graspforce.service.client.watchdog import CommandMonitor, Watchdog
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import CommandRecord, RemoteCommand
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.stream_state import StreamState

log = logging.getLogger("graspforce.service")

_RETRY_PERIOD = 0.05  # s between attempts to open a stream again
_PAUSE_TIMEOUT = 1.0  # s without a state: the driver has paused, and nothing is missing
_BUSY_WAIT = 1e-3  # s that a driver waits without falling asleep, letting others go first: to be woken takes 40 µs and more
_POLL_PERIOD = 1e-4  # s: after that it looks so often
_COMMAND_DECODERS: dict[str, Any] = {
    protocol.MSGPACK: msgspec.msgpack.Decoder(CommandRecord),
    protocol.JSON: msgspec.json.Decoder(CommandRecord),
}


class StreamConnection(Protocol):
    """A stream's way to its server."""

    def send(self, payload: bytes) -> None:
        """Send a state, without waiting for anybody."""

    def receive(self) -> tuple[bytes, str] | None:
        """The newest command that nobody has looked at, its bytes and encoding; None, without waiting, where there is none."""

    def close(self) -> None:
        """Send and receive no more."""


class Stream:
    """A control stream: an object follows, its torques worked out by a server. A context manager.

    It can stand wherever an `ObjectController` can: ``step(state, desired)`` returns what the motors are to do. That is the
    server's command while one comes in time, and the watchdog's torque while none does; ``late`` and ``resuming`` tell.
    One thread uses it.

    Attributes:
        id: the stream's, below ``streams/``.
        opening: what stays fixed.
        trouble: why no command came last; None while all is well.
        sequence: the number of the last state that was sent; 0 before the first.

    Args:
        id: the stream's id.
        opening: what stays fixed.
        watchdog: what the motors get while commands fail to come.
        codec: of the states.
        timeout: how long `step` waits for the very first command, s.
        ask: puts a record to the stream's key and returns the answer.
        connect: makes the way to the server.

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
        query: Callable[[Mapping[str, Any]], Mapping[str, Any]],
        connect: Callable[[], StreamConnection],
    ) -> None:
        self.id, self.setup = id, setup
        self.last_error: ServiceError | None = None
        self._codec, self._timeout, self._query = codec, timeout, query
        self._hand = setup.grasp.hand
        self._monitor = CommandMonitor(watchdog, setup.validity, self._hand.torque_lower, self._hand.torque_upper)
        self.sequence = 0
        self._state: GraspState | None = None
        self._sent_time = -np.inf  # when the last state was sent, s
        self._last_command: RemoteCommand | None = None
        self._last_received = time.monotonic()  # when the last good command came, s
        self._closed = threading.Event()
        self._connection = connect()
        try:
            query(setup.to_dict())
        except BaseException:
            self._connection.close()
            raise
        self._reconnect_thread = threading.Thread(target=self._reconnect, name=f"keeper-{id}", daemon=True)
        self._reconnect_thread.start()

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the stream here and at the server. A second call does nothing."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._reconnect_thread.join()
        with contextlib.suppress(ServiceError):  # a server that is away closes an idle stream by itself
            self._query({"close": True})
        self._connection.close()

    def step(
        self, state: GraspState, desired: DesiredMotion, external: Any = None, *, wait: float | None = None
    ) -> RemoteCommand:
        """Publish a state and wait for its command; what the motors are to do, whether it comes or not.

        Args:
            state: the hand and the object now, as measured.
            desired: where the object should be, and its desired twist and acceleration; in a `GraspMotion` the joints' too.
            external: (6,) an estimate of the wrench on the object that is neither gravity nor the fingers', about O's origin,
                in O, N and N·m; None for none.
            wait: how long to wait, s; by default one period. For the very first command it is the client's timeout. The first
                millisecond is waited awake: it keeps a processor busy, and saves the time to be woken.

        Raises:
            InvalidInput: a state of another hand.
            ServiceTimeout: the very first command did not come.
            ErrorReply: the server refused the very first state.
        """
        if self._last_command is None:
            self._wait_for_first_command(state, desired, external)
        else:
            self._wait_for_command(self.publish(state, desired, external), self.setup.settings.period if wait is None else wait)
        command = self.latest()
        assert command is not None  # there was a good command
        return command

    def publish(self, state: GraspState, desired: DesiredMotion, external: Any = None) -> int:
        """Send a state and wait for nothing; its number, which the command repeats. Arguments as in `step`."""
        check_joint_count(self._hand, state.q, desired)
        wrench = None if external is None else arrays.check_array(external, "external", (6,))
        self.sequence += 1
        self._state, self._sent_time = state, time.monotonic()
        sent = StreamState(self.sequence, self._sent_time, state, desired, wrench)
        self._connection.send(sent.encode(self._codec))
        return self.sequence

    def latest(self) -> RemoteCommand | None:
        """What the motors are to do now, without waiting: the newest command, or the watchdog's torque.

        None before the first command. Ask once a period: each answer goes one bounded step on.
        """
        self._read_newest()
        if self._last_command is None or self._state is None:
            return None
        output = self._monitor.torque(time.monotonic(), self._state.q, self._state.v)
        assert output is not None  # there was a good command
        warnings = self._last_command.warnings
        if output.late:
            said = self.last_error or "no command came"
            warnings = (*warnings, f"{said}: the watchdog holds, {output.age:.3f} s after the last good command")
        return RemoteCommand(
            output.tau, warnings, output.age, output.late, output.resuming, self._last_command.record, self._last_command.grasp
        )

    def _wait_for_first_command(self, state: GraspState, desired: DesiredMotion, external: Any) -> None:
        """Send a state again and again until there is a first good command: one may be lost, or come too late."""
        deadline = time.monotonic() + self._timeout
        while self._last_command is None:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise ServiceTimeout(f"stream {self.id} had no command within {self._timeout:g} s")
            self._wait_for_command(self.publish(state, desired, external), min(left, max(self.setup.validity, _RETRY_PERIOD)))
            if self._last_command is None and self.last_error is not None:
                raise self.last_error

    def _wait_for_command(self, sequence: int, wait: float) -> None:
        """Wait so long, s, for the command of a state; a server's refusal before the first good command ends the wait too."""
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
        """Look at the newest command; whether there was one."""
        came = self._connection.receive()
        if came is not None:
            self._accept(*came)
        return came is not None

    def _accept(self, payload: bytes, encoding: str) -> None:
        """Take a command for the last good one, if it is good."""
        try:
            sent = _COMMAND_DECODERS[protocol.select_codec(encoding)].decode(payload)
            command = sent.unpack(self.setup.grasp)
        except (msgspec.MsgspecError, ValueError, RecursionError):  # ValueError: arrays of other sizes
            self.last_error = _read_failure(payload, encoding)
            return
        # What is not the answer to a state of this stream is none, nor is what the server itself calls late.
        if sent.late or sent.time is None or not sent.time <= self._sent_time:
            return
        if len(command.tau) != self._hand.n or not math.isfinite(sum(command.tau.tolist())):
            self.last_error = ErrorReply("internal", f"the server's torque is none: {format_value(command.tau)}", "torque")
            return
        now = time.monotonic()
        if self._monitor.accept(command.tau, sent.time, now):
            self._last_command, self._last_received, self.last_error = command, now, None

    def _reconnect(self) -> None:
        """Open the stream again while the driver sends states and no good command comes."""
        while not self._closed.wait(_RETRY_PERIOD):
            now = time.monotonic()
            if now - self._sent_time > _PAUSE_TIMEOUT or now - self._last_received < max(
                self.setup.validity, 2.0 * _RETRY_PERIOD
            ):
                continue
            left = None if self._last_command is None else self._last_command.memory
            try:
                try:
                    self._query(dataclasses.replace(self.setup, memory=left).to_dict())
                except ErrorReply:  # perhaps it is what was left that the server cannot take: then a fresh start
                    self._query(self.setup.to_dict())
            except ServiceError as error:
                self.last_error = error


def _read_failure(payload: bytes, encoding: str) -> ServiceError:
    """What an answer that is no command says."""
    try:
        return protocol.read_error(protocol.decode(payload, protocol.select_codec(encoding)))
    except InvalidInput as unreadable:
        return ErrorReply("internal", f"the server's answer could not be read: {unreadable}", None)
