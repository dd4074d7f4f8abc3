"""Control streams as the server keeps them: opened once, then a state in and a command out, bytes both. No network here."""

from __future__ import annotations

import contextvars
import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import numpy as np

from graspforce.control import Command, ControlMemory
from graspforce.control.object_controller import ObjectControlLaw
from graspforce.core import fields
from graspforce.core.errors import InvalidInput, RequestRefused, UnknownName
from graspforce.hand.hand import Hand
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.wire.control_records import ControlRequest, StreamSetup
from graspforce.service.wire.reply import Reply, describe_error, make_error_reply
from graspforce.service.wire.stream_state import StreamState

_LARGEST_STATE = 64 * 2**10  # bytes; the state of a hand of 20 joints has one kilobyte
_LONGEST_ID = 64  # characters


class ServerStream:
    """One open stream. One thread at a time gives it states.

    Attributes:
        id: what its key says after ``streams/``.
        opening: what stays fixed.
        outcomes: how its states ended: "ok", or an error's code.
        skipped: states that newer ones replaced before they were looked at, by the gaps in their numbers.
        last: when its last state came, on the clock `time.perf_counter`, s.

    Args:
        id: the id.
        opening: what stays fixed.
    """

    def __init__(self, id: str, setup: StreamSetup) -> None:
        self.id, self.setup = id, setup
        self.outcomes: Counter[str] = Counter()
        self.skipped = 0
        self.last_received = time.perf_counter()
        self._law = ObjectControlLaw(setup.grasp, setup.settings)
        self._memory = setup.memory or self._law.initial_memory()
        self._sequence: int | None = None
        self._silent_context = _silent_context()

    def command(self, payload: bytes, encoding: str | None, received: float | None = None) -> Reply:
        """The command for a state, whatever that holds: every error becomes an error record.

        Args:
            payload: the state.
            encoding: its Zenoh encoding; None for JSON.
            received: when it came, on the clock `time.perf_counter`; None for now.
        """
        self.last_received = received = time.perf_counter() if received is None else received
        codec = protocol.JSON
        try:
            codec = protocol.select_codec(encoding)
            if len(payload) > _LARGEST_STATE:
                raise RequestRefused("too_large", f"the state has {len(payload)} bytes: at most {_LARGEST_STATE} are allowed")
            reply, outcome = Reply(True, self._answer(payload, codec, received), codec), "ok"
        except Exception as error:
            outcome, message, field = describe_error(error, f"streams/{self.id}/state")
            reply = make_error_reply(codec, outcome, message, field, _sequence(payload, codec))
        self.outcomes[outcome] += 1
        return reply

    def _answer(self, payload: bytes, codec: str, received: float) -> bytes:
        sent = StreamState.decode(self.setup.grasp.hand, payload, codec)
        if self._sequence is not None and sent.sequence > self._sequence:
            self.skipped += sent.sequence - self._sequence - 1
        self._sequence = sent.sequence
        command, self._memory = self._silent_context.run(_step, self._law, self._memory, sent)
        record = CommandRecord.pack(command, self._memory, sent.binary)
        record.sequence, record.time = sent.sequence, sent.time
        record.server_seconds = time.perf_counter() - received
        record.late = record.server_seconds > self.setup.validity
        return protocol.encode(record, codec)


class StreamRegistry:
    """The streams that are open. Safe to use from several threads.

    Args:
        hands: the hands that are served, by name.
        room: how many streams may be open; beyond, ``overloaded``.
        idle: how long a stream stays open without a state, s.
        opened: called with each stream that was opened, before its opener is told.
        closed: called with each stream that was closed.
    """

    def __init__(
        self,
        hands: Mapping[str, Hand],
        *,
        capacity: int,
        idle_timeout: float,
        on_open: Callable[[ServerStream], None] = lambda stream: None,
        on_close: Callable[[ServerStream], None] = lambda stream: None,
    ) -> None:
        self._hands, self._capacity, self.idle_timeout = hands, capacity, idle_timeout
        self._on_open, self._on_close = on_open, on_close
        self._lock = threading.Lock()
        self._open: dict[str, ServerStream] = {}
        self._closed_outcomes: Counter[str] = Counter()  # outcomes of states of streams that are closed

    def __len__(self) -> int:
        return len(self._open)

    def __getitem__(self, id: str) -> ServerStream:
        return self._open[id]

    def outcomes(self) -> dict[str, int]:
        """How all states ended so far."""
        with self._lock:
            total = Counter(self._closed_outcomes)
            for stream in self._open.values():
                total.update(dict(stream.outcomes))
        return dict(total)

    def answer(self, id: str, record: Any) -> dict[str, Any]:
        """Open a stream, or close it where the record is ``{"close": true}``.

        To open what is open already with the same record changes nothing, so that a client that lost sight of its server can
        ask again; what an earlier stream left (``memory``) is then not looked at.

        Args:
            id: the stream's.
            record: its opening.

        Raises:
            InvalidInput: the record is none, or another stream has the id.
            UnknownName: a hand that is not served, or to close a stream that is not open.
            Refused: no room.
        """
        if not id or len(id) > _LONGEST_ID:
            raise InvalidInput("stream", id, f"of 1 to {_LONGEST_ID} characters")
        if isinstance(record, Mapping) and "close" in record:
            if fields.check_record(record, "", required=["close"])["close"] is not True:
                raise InvalidInput("close", record["close"], "true")
            return self._close(id)
        setup = StreamSetup.from_dict(self._hands, record)
        with self._lock:
            known = self._open.get(id)
            if known is None:
                if len(self._open) >= self._capacity:
                    raise RequestRefused("overloaded", f"{len(self._open)} streams are open: no more are allowed")
                stream = ServerStream(id, setup)
                self._on_open(stream)
                self._open[id] = stream
            elif _fixed_fields(known.setup) != _fixed_fields(setup):
                raise InvalidInput("stream", id, "an id that no other stream has: that one can be closed first")
        return {"stream": id, "opened": known is None, "idle": self.idle_timeout}

    def expire(self, now: float) -> None:
        """Close the streams whose clients have sent nothing for too long.

        Args:
            now: on the clock `time.perf_counter`, s.
        """
        self._end([stream for stream in list(self._open.values()) if now - stream.last_received > self.idle_timeout])

    def close(self) -> None:
        """Close all."""
        self._end(list(self._open.values()))

    def _close(self, id: str) -> dict[str, Any]:
        stream = self._open.get(id)
        if stream is None:
            raise UnknownName("stream", id, (), "the id of a stream that is open")
        self._end([stream])
        return {"stream": id, "outcomes": dict(stream.outcomes), "skipped": stream.skipped}

    def _end(self, streams: list[ServerStream]) -> None:
        for stream in streams:
            with self._lock:
                if self._open.get(stream.id) is not stream:
                    continue
                del self._open[stream.id]
            self._on_close(stream)
            with self._lock:
                self._closed_outcomes.update(stream.outcomes)


def answer_control_request(request: ControlRequest) -> dict[str, Any]:
    """The record of a command, for a request that stands for itself; with the force problem's certified answer."""
    law = ObjectControlLaw(request.grasp, request.settings)
    command, memory = _silent_context().run(_step, law, request.memory or law.initial_memory(), request)
    return {**msgspec.to_builtins(CommandRecord.pack(command, memory)), "solution": command.solution.to_dict()}


def _step(law: ObjectControlLaw, memory: ControlMemory, inputs: ControlRequest | StreamState) -> tuple[Command, ControlMemory]:
    """One step of the law.

    Raises:
        InvalidInput: numbers so large that the torques are none.
    """
    command, left = law.step(memory, inputs.state, inputs.desired, inputs.external)
    if not math.isfinite(sum(command.tau.tolist()) + sum(left.integral.tolist())):
        raise InvalidInput("state", "its numbers", "of a size from which finite torques follow")
    return command, left


def _silent_context() -> contextvars.Context:
    """Where NumPy says nothing of what overflows: that is refused, or cannot be certified. Quicker to enter than `errstate`."""
    context = contextvars.copy_context()
    context.run(np.seterr, all="ignore")
    return context


def _fixed_fields(setup: StreamSetup) -> dict[str, Any]:
    """What two openings of one stream must have in common."""
    record = setup.to_dict()
    record.pop("memory", None)
    return record


def _sequence(payload: bytes, codec: str) -> int | None:
    """The number of a state that is wrong, where it can be read."""
    try:
        return protocol.find_sequence(protocol.decode(payload, codec)) if len(payload) <= _LARGEST_STATE else None
    except InvalidInput:
        return None
