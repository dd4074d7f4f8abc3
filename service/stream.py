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

from graspforce import arrays
from graspforce.control import Desired, GraspState, fit
from graspforce.errors import ErrorReply, InvalidInput, ServiceError, ServiceTimeout, shown
from graspforce.service import wire
from graspforce.service.commands import RemoteCommand, SentCommand
from graspforce.service.control_records import StreamOpening
from graspforce.service.stream_state import StreamState
from graspforce.service.watchdog import Guard, Watchdog

log = logging.getLogger("graspforce.service")

_RETRY = 0.05  # s between attempts to open a stream again
_PAUSED = 1.0  # s without a state: the driver has paused, and nothing is missing
_AWAKE = 1e-3  # s that a driver waits without falling asleep, letting others go first: to be woken takes 40 µs and more
_DOZE = 1e-4  # s: after that it looks so often
_READ_COMMAND: dict[str, Any] = {
    wire.MSGPACK: msgspec.msgpack.Decoder(SentCommand),
    wire.JSON: msgspec.json.Decoder(SentCommand),
}


class Link(Protocol):
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
        opening: StreamOpening,
        *,
        watchdog: Watchdog,
        codec: str,
        timeout: float,
        ask: Callable[[Mapping[str, Any]], Mapping[str, Any]],
        connect: Callable[[], Link],
    ) -> None:
        self.id, self.opening = id, opening
        self.trouble: ServiceError | None = None
        self._codec, self._timeout, self._ask = codec, timeout, ask
        self._hand = opening.hold.hand
        self._guard = Guard(watchdog, opening.validity, self._hand.torque_lower, self._hand.torque_upper)
        self.sequence = 0
        self._state: GraspState | None = None
        self._sent = -np.inf  # when the last state was sent, s
        self._last: RemoteCommand | None = None
        self._heard = time.monotonic()  # when the last good command came, s
        self._closed = threading.Event()
        self._link = connect()
        try:
            ask(opening.to_dict())
        except BaseException:
            self._link.close()
            raise
        self._keeper = threading.Thread(target=self._keep, name=f"keeper-{id}", daemon=True)
        self._keeper.start()

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the stream here and at the server. A second call does nothing."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._keeper.join()
        with contextlib.suppress(ServiceError):  # a server that is away closes an idle stream by itself
            self._ask({"close": True})
        self._link.close()

    def step(self, state: GraspState, desired: Desired, external: Any = None, *, wait: float | None = None) -> RemoteCommand:
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
        if self._last is None:
            self._begin(state, desired, external)
        else:
            self._answer(self.publish(state, desired, external), self.opening.settings.period if wait is None else wait)
        command = self.latest()
        assert command is not None  # there was a good command
        return command

    def publish(self, state: GraspState, desired: Desired, external: Any = None) -> int:
        """Send a state and wait for nothing; its number, which the command repeats. Arguments as in `step`."""
        fit(self._hand, state.q, desired)
        wrench = None if external is None else arrays.array(external, "external", (6,))
        self.sequence += 1
        self._state, self._sent = state, time.monotonic()
        sent = StreamState(self.sequence, self._sent, state, desired, wrench)
        self._link.send(sent.encode(self._codec))
        return self.sequence

    def latest(self) -> RemoteCommand | None:
        """What the motors are to do now, without waiting: the newest command, or the watchdog's torque.

        None before the first command. Ask once a period: each answer goes one bounded step on.
        """
        self._read()
        if self._last is None or self._state is None:
            return None
        watched = self._guard.torque(time.monotonic(), self._state.q, self._state.v)
        assert watched is not None  # there was a good command
        warnings = self._last.warnings
        if watched.late:
            said = self.trouble or "no command came"
            warnings = (*warnings, f"{said}: the watchdog holds, {watched.age:.3f} s after the last good command")
        return RemoteCommand(
            watched.tau, warnings, watched.age, watched.late, watched.resuming, self._last.sent, self._last.hold
        )

    def _begin(self, state: GraspState, desired: Desired, external: Any) -> None:
        """Send a state again and again until there is a first good command: one may be lost, or come too late."""
        deadline = time.monotonic() + self._timeout
        while self._last is None:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise ServiceTimeout(f"stream {self.id} had no command within {self._timeout:g} s")
            self._answer(self.publish(state, desired, external), min(left, max(self.opening.validity, _RETRY)))
            if self._last is None and self.trouble is not None:
                raise self.trouble

    def _answer(self, sequence: int, wait: float) -> None:
        """Wait so long, s, for the command of a state; a server's refusal before the first good command ends the wait too."""
        start = time.monotonic()
        while self._last is None or self._last.sequence != sequence:
            if self._read():
                if self._last is None and self.trouble is not None:
                    return
                continue
            waited = time.monotonic() - start  # s
            if waited >= wait:
                return
            if waited < _AWAKE:
                os.sched_yield()
            else:
                time.sleep(min(_DOZE, wait - waited))

    def _read(self) -> bool:
        """Look at the newest command; whether there was one."""
        came = self._link.receive()
        if came is not None:
            self._look_at(*came)
        return came is not None

    def _look_at(self, payload: bytes, encoding: str) -> None:
        """Take a command for the last good one, if it is good."""
        try:
            sent = _READ_COMMAND[wire.codec(encoding)].decode(payload)
            command = sent.received(self.opening.hold)
        except (msgspec.MsgspecError, ValueError, RecursionError):  # ValueError: arrays of other sizes
            self.trouble = _trouble(payload, encoding)
            return
        # What is not the answer to a state of this stream is none, nor is what the server itself calls late.
        if sent.late or sent.time is None or not sent.time <= self._sent:
            return
        if len(command.tau) != self._hand.n or not math.isfinite(sum(command.tau.tolist())):
            self.trouble = ErrorReply("internal", f"the server's torque is none: {shown(command.tau)}", "torque")
            return
        now = time.monotonic()
        if self._guard.heard(command.tau, sent.time, now):
            self._last, self._heard, self.trouble = command, now, None

    def _keep(self) -> None:
        """Open the stream again while the driver sends states and no good command comes."""
        while not self._closed.wait(_RETRY):
            now = time.monotonic()
            if now - self._sent > _PAUSED or now - self._heard < max(self.opening.validity, 2.0 * _RETRY):
                continue
            left = None if self._last is None else self._last.memory
            try:
                try:
                    self._ask(dataclasses.replace(self.opening, memory=left).to_dict())
                except ErrorReply:  # perhaps it is what was left that the server cannot take: then a fresh start
                    self._ask(self.opening.to_dict())
            except ServiceError as error:
                self.trouble = error


def _trouble(payload: bytes, encoding: str) -> ServiceError:
    """What an answer that is no command says."""
    try:
        return wire.failure(wire.decode(payload, wire.codec(encoding)))
    except InvalidInput as unreadable:
        return ErrorReply("internal", f"the server's answer could not be read: {unreadable}", None)
