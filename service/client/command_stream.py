"""A stream as the driver uses it: states out, commands in, and a motor torque in every period.

A stream is a state machine:

| state    | motor torque                | leaves the state when                                                   |
|----------|-----------------------------|-------------------------------------------------------------------------|
| opening  | none: `latest` returns None | the first good command arrives → running                                |
| running  | the server's                | the last good command is older than `validity` → lost                   |
| lost     | the watchdog's (`late`)     | a good command arrives → resuming                                       |
| resuming | rate-limited (`resuming`)   | the torque reaches the commands → running; commands stop again → lost   |
| closed   | none                        |                                                                         |

The age of a command counts from when its state was sent, on the client's clock (`graspforce.service.client.watchdog` has the
law). While no good command arrives, a thread opens the stream again every 50 ms, if the kind of stream can continue. The thread
does nothing if the driver has sent no states for a second.

The newest command stays with the connection until the driver reads it; its arrival wakes no Python thread. This module does not
use the network: the client passes the connection in.
"""

from __future__ import annotations

import contextlib
import math
import os
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import msgspec
import numpy as np

from graspforce.core.arrays import Array
from graspforce.core.compiled import native
from graspforce.core.errors import ErrorReply, InvalidInput, RequestRefused, ServiceError, ServiceTimeout, format_value
from graspforce.core.json_text import JsonRecord
from graspforce.hand.hand import Hand
from graspforce.service.client.replies import make_unreadable_error
from graspforce.service.client.watchdog import CommandMonitor, MotorTorque, Watchdog
from graspforce.service.wire import protocol
from graspforce.service.wire.stream_authentication import ownership_proof, read_key

_RETRY_PERIOD = 0.05  # s, between attempts to open the stream again
_PAUSE_TIMEOUT = 1.0  # s, without states: the driver has paused
_MAX_PROOFS, _TOKEN_BYTES = 4, 32  # in a request
_BUSY_WAIT = 1e-3  # s, of waiting without sleep, because waking up takes tens of microseconds
_POLL_PERIOD = 1e-4  # s, between checks after that
_NOTHING = np.zeros(0)


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


class OpenSetup(Protocol):
    """Fixed parameters of a stream of any kind."""

    @property
    def hand(self) -> Hand: ...  # pragma: no cover
    @property
    def period(self) -> float: ...  # pragma: no cover
    @property
    def validity(self) -> float: ...  # pragma: no cover
    def to_dict(self) -> JsonRecord: ...  # pragma: no cover


class ReceivedRecord(Protocol):
    """Fields of a command's record that every stream uses."""

    @property
    def late(self) -> bool: ...  # pragma: no cover
    @property
    def time(self) -> float | None: ...  # pragma: no cover


class ReceivedCommand(Protocol):
    """A command of any kind of stream."""

    @property
    def tau(self) -> Array: ...  # pragma: no cover
    @property
    def sequence(self) -> int | None: ...  # pragma: no cover
    @property
    def record(self) -> ReceivedRecord: ...  # pragma: no cover


@dataclass(frozen=True, eq=False, slots=True)
class StreamLink:
    """What a stream of any kind needs to reach its server.

    Args:
        watchdog: motor torque while no commands arrive.
        codec: encoding of the states.
        timeout: how long `step` waits for the first command, s.
        query: function that sends a record to the stream's key and returns the answer.
        connect: function that returns the connection.
    """

    watchdog: Watchdog
    codec: str
    timeout: float
    query: Callable[[JsonRecord], JsonRecord]
    connect: Callable[[], StreamConnection]


C = TypeVar("C", bound=ReceivedCommand)
S = TypeVar("S", bound="CommandStream[Any]")


class CommandStream(Generic[C]):
    """Client's end of a stream. Use it from one thread, as a context manager or with `close`.

    Attributes:
        id: id of the stream, its key after ``streams/``.
        last_error: reason why the last command is missing; None if it arrived.
        sequence: number of the last state sent; 0 before the first.

    Args:
        id: id of the stream.
        setup: fixed parameters.
        link: watchdog, encoding and connection.

    Raises:
        ServiceError: the stream cannot be opened.
    """

    def __init__(self, id: str, setup: OpenSetup, link: StreamLink) -> None:
        self.id = id
        self.last_error: ServiceError | None = None
        self.sequence = 0
        self._codec, self._timeout, self._query, self._validity = link.codec, link.timeout, link.query, setup.validity
        self._hand = hand = setup.hand
        limits = hand.torque_lower, hand.torque_upper
        self._monitor = CommandMonitor(link.watchdog, setup.validity, *limits, self._largest_step())
        self._sent_time = -np.inf  # when the last state was sent, s
        self._last_command: C | None = None
        self._last_received = time.monotonic()  # when the last good command arrived, s
        self._closed, self._wake = threading.Event(), threading.Event()
        self._is_server_closing = False
        self._connection = link.connect()
        self._proofs: list[str] = []  # of all openings, the newest first, and the token of the stream
        try:
            self._open(setup.to_dict())
        except BaseException:
            self._connection.close()
            raise
        self._reconnect_thread = threading.Thread(target=self._reconnect, name=f"reconnect-{id}", daemon=True)
        self._reconnect_thread.start()

    def __enter__(self: S) -> S:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the stream here and at the server. A second call does nothing."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._wake.set()
        self._reconnect_thread.join()
        with contextlib.suppress(ServiceError):  # a server that cannot be reached closes the stream when it is idle
            self._query({"close": True, **self._proof()})
        self._connection.close()

    def _open(self, setup: JsonRecord) -> None:
        """Open the stream at the server, and take the key of this opening."""
        if setup.get("authenticated") and not self._proofs:
            self._proofs = [secrets.token_hex(_TOKEN_BYTES)]  # proves an opening whose answer got lost
        answer = self._query({**setup, **self._proof()})
        if setup.get("authenticated"):
            try:
                key = read_key(answer.get("key"))
            except InvalidInput as error:
                raise make_unreadable_error(error) from None
            self._connection.authenticate(key)
            proof = ownership_proof(key, self.id)
            *others, token = (each for each in self._proofs if each != proof)
            self._proofs = [proof, *others[: _MAX_PROOFS - 2], token]

    def _proof(self) -> JsonRecord:
        """Return the proofs of ownership of a request."""
        return {"proof": self._proofs} if self._proofs else {}

    # ── of each kind ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _decode(self, payload: bytes, codec: str) -> C:
        """Return a command.

        Raises:
            msgspec.MsgspecError: not a command.
            ValueError: an array has the wrong size.
        """
        raise NotImplementedError

    def _facts(self, command: C) -> ReceivedRecord:
        """Return the fields of a command's record that every stream uses."""
        return command.record

    def _largest_step(self) -> Array | float:
        """Return the largest change of the torques per period while commands arrive, (n,), N·m."""
        return np.inf

    def _setups_to_continue(self) -> list[JsonRecord]:
        """Return the setups with which the stream may be opened again, in the order of trial; empty if it cannot continue."""
        return []

    def _take(self, command: C) -> None:
        """Continue with a good command."""

    def _take_error(self, error: ServiceError) -> None:
        """Continue after an error in place of a command."""

    # ── states ───────────────────────────────────────────────────────────────────────────────────────────────────────────

    def _next_sequence(self) -> tuple[int, float]:
        """Return sequence number and time of the next state, s."""
        self.sequence += 1
        self._sent_time = time.monotonic()
        return self.sequence, self._sent_time

    def _exchange(self, send: Callable[[], int], wait: float) -> None:
        """Send a state and wait for its command, at most for a time in s; longer for the first command of the stream."""
        if self._last_command is not None:
            self._wait_for_command(send(), wait)
            return
        deadline = time.monotonic() + self._timeout
        while self._last_command is None:  # a command may get lost, or expire
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                raise ServiceTimeout(f"stream {self.id}: no command within {self._timeout:g} s")
            self._wait_for_command(send(), min(remaining, max(self._validity, _RETRY_PERIOD)))
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

    # ── commands ─────────────────────────────────────────────────────────────────────────────────────────────────────────

    def _motor_torque(self, q: Array, v: Array) -> MotorTorque:
        """Return the torque of this period: the last good command's or the watchdog's. Not before the first command."""
        output = self._monitor.torque(time.monotonic(), q, v)
        assert output is not None  # after the first good command
        return output

    def _late_warning(self, output: MotorTorque) -> tuple[str, ...]:
        """Return the warning of a torque of the watchdog; empty for none."""
        if not output.late:
            return ()
        reason = self.last_error or "no command arrived"
        return (f"{reason}: the watchdog is active, the last good command is {output.age:.3f} s old",)

    def _read_newest(self) -> bool:
        """Read the newest command; return True if there was one."""
        message = self._connection.receive()
        if message is not None:
            self._accept(*message)
        return message is not None

    def _accept(self, payload: bytes, encoding: str) -> None:
        """Store a command if it is good, or the error that arrived in its place."""
        try:
            command = self._decode(payload, protocol.select_codec(encoding))
        except (msgspec.MsgspecError, ValueError, RecursionError):  # ValueError: arrays of wrong size
            self.last_error = _read_failure(payload, encoding)
            if isinstance(self.last_error, RequestRefused) and self.last_error.code == "closing":
                self._is_server_closing = True
                self._wake.set()
            self._take_error(self.last_error)
            return
        # Ignore commands that the server marks as late, and commands that answer no state of this stream.
        record = self._facts(command)
        if record.late or record.time is None or not record.time <= self._sent_time:
            return
        if len(command.tau) != self._hand.n or not _is_finite(command.tau):
            message = f"the server's torque is invalid: {format_value(command.tau)}"
            self.last_error = ErrorReply("internal", message, "torque")
            return
        now = time.monotonic()
        if self._monitor.accept(command.tau, record.time, now):
            self._last_command, self._last_received, self.last_error = command, now, None
            self._take(command)

    def _reconnect(self) -> None:
        """Open the stream again while the driver sends states and no good command arrives, or when the server closes."""
        patience = max(self._validity, 2.0 * _RETRY_PERIOD)  # s
        while not self._closed.is_set():
            self._wake.wait(_RETRY_PERIOD)
            self._wake.clear()
            now = time.monotonic()
            is_running = now - self._last_received < patience and not self._is_server_closing
            if self._closed.is_set() or now - self._sent_time > _PAUSE_TIMEOUT or is_running:
                continue
            self._is_server_closing = False
            setups = self._setups_to_continue()
            for k, record in enumerate(setups):
                try:
                    self._open(record)
                    break
                except ErrorReply as error:  # the server may reject the memory: the next setup has none
                    if k + 1 == len(setups):
                        self.last_error = error
                except ServiceError as error:
                    self.last_error = error
                    break


def _is_finite(tau: Array) -> bool:
    """Return whether all torques are finite; their sum then is, too, unless it overflows."""
    return bool(native.has_finite_sum(tau, _NOTHING)) if native is not None else math.isfinite(sum(tau.tolist()))


def _read_failure(payload: bytes, encoding: str) -> ServiceError:
    """Return the exception of a message that is not a command."""
    try:
        return protocol.read_error(protocol.decode(payload, protocol.select_codec(encoding)))
    except InvalidInput as error:
        return ErrorReply("internal", f"the server's answer cannot be read: {error}", None)
