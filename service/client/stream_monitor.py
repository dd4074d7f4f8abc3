"""A monitor of a running stream: it reads states and commands beside the driver, and never takes part.

Zenoh copies the messages to the monitor in threads of its own, and drops them if the monitor is late. The control step of the
server does not wait for it. A view follows samples of both: copies of all messages would slow a stream at 1 kHz.
"""

from __future__ import annotations

import contextlib
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import msgspec
import zenoh
from zenoh.handlers import RingChannel

from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.hand.hand import Hand
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.joint_records import JointCommandRecord, JointState, JointStreamSetup
from graspforce.service.wire.phase_records import PhaseCommandRecord, PhaseState, PhaseStreamSetup
from graspforce.service.wire.stream_setups import AnySetup, read_setup
from graspforce.service.wire.stream_state import StreamState

_RING_SIZE = 4096  # messages: 4 s of a stream at 1 kHz
_WAITING = 64  # states whose commands may still arrive


def _decoders(record: type) -> dict[str, Any]:
    """Return the decoders of a command by encoding."""
    return {protocol.JSON: msgspec.json.Decoder(record), protocol.MSGPACK: msgspec.msgpack.Decoder(record)}


COMMAND_DECODERS: dict[str, Any] = _decoders(CommandRecord)
"""Decoders of the commands of a held object by encoding."""
_PHASE_DECODERS, _JOINT_DECODERS = _decoders(PhaseCommandRecord), _decoders(JointCommandRecord)


class StreamStep(NamedTuple):
    """A state of a stream and its command.

    Attributes:
        state: the state.
        command: the command, with arrays as on the wire.
    """

    state: StreamState
    command: CommandRecord


class PhaseStreamStep(NamedTuple):
    """A state of a stream of phases and its command.

    Attributes:
        state: the state.
        command: the command, with arrays as on the wire.
    """

    state: PhaseState
    command: PhaseCommandRecord


class JointStreamStep(NamedTuple):
    """A state of a stream of a joint-space law and its command.

    Attributes:
        state: the state.
        command: the command, with arrays as on the wire.
    """

    state: JointState
    command: JointCommandRecord


AnyStreamStep = StreamStep | PhaseStreamStep | JointStreamStep


class _Kind(NamedTuple):
    """How the messages of a stream are read."""

    decode: Callable[[bytes, str], Any]  # payload and codec to a state
    decoders: Mapping[str, Any]  # of commands, by encoding
    step: Callable[[Any, Any], AnyStreamStep]


class StreamMonitor:
    """A subscriber to the states and commands of one stream. One thread at a time uses it. Close it with `close`.

    Args:
        session: an open session.
        id: id of the stream, its key after ``streams/``.
        record: the record that opened it.
        sampled: follow the server's samples, at most `protocol.SAMPLE_RATE` a second, in place of all messages.
    """

    def __init__(self, session: zenoh.Session, id: str, record: JsonRecord, *, sampled: bool = False) -> None:
        self.id, self.record = id, record
        key = f"{protocol.PREFIX}/streams/{id}" + (f"/{protocol.SAMPLED}" if sampled else "")
        self._states = session.declare_subscriber(f"{key}/state", RingChannel(_RING_SIZE))
        self._commands = session.declare_subscriber(f"{key}/command", RingChannel(_RING_SIZE))
        self._waiting: OrderedDict[int, Any] = OrderedDict()
        self._known_kind: _Kind | None = None

    @property
    def hand_name(self) -> str:
        """Name of the hand."""
        return str(self.record["hand"])

    def read_any_setup(self, hands: Mapping[str, Hand]) -> AnySetup:
        """Return the setup of the stream.

        Args:
            hands: hands by name, with that of the stream.

        Raises:
            UnknownName: its hand is not among `hands`.
        """
        setup = read_setup(hands, self.record)
        self._known_kind = _kind(setup)
        return setup

    def read_setup(self, hands: Mapping[str, Hand]) -> StreamSetup:
        """Return the setup of a stream that controls a held object.

        Args:
            hands: hands by name, with that of the stream.

        Raises:
            InvalidInput: the stream controls no held object: it has phases, or controls joints.
            UnknownName: its hand is not among `hands`.
        """
        setup = self.read_any_setup(hands)
        if not isinstance(setup, StreamSetup):
            raise InvalidInput("--stream", self.id, "a stream that controls a held object; this one has another kind")
        return setup

    @property
    def _kind(self) -> _Kind:
        """The kind of the stream, after `read_any_setup`."""
        if self._known_kind is None:
            raise InvalidInput("setup", None, "read by read_setup before the first step")
        return self._known_kind

    def take_all(self) -> list[Any]:
        """Return the steps since the last call, the earliest first, without unreadable messages. Does not wait.

        They are of the type that belongs to the setup: `StreamStep`, `PhaseStreamStep` or `JointStreamStep`.
        """
        for sample in _drain(self._states):
            self._keep_state(sample)
        steps = []
        for sample in _drain(self._commands):
            command = self._read_command(sample)
            state = None if command is None or command.sequence is None else self._waiting.pop(command.sequence, None)
            if state is not None:
                steps.append(self._kind.step(state, command))
        while len(self._waiting) > _WAITING:
            self._waiting.popitem(last=False)
        return steps

    def take_newest(self) -> AnyStreamStep | None:
        """Return the newest step since the last call, or None. Does not wait, and reads two messages only, mostly."""
        states, commands = _drain(self._states), _drain(self._commands)
        for sample in states[-_WAITING:]:
            self._keep_state(sample)
        while len(self._waiting) > _WAITING:
            self._waiting.popitem(last=False)
        for sample in reversed(commands):
            command = self._read_command(sample)
            state = None if command is None or command.sequence is None else self._waiting.get(command.sequence)
            if state is not None:
                return self._kind.step(state, command)
        return None

    def close(self) -> None:
        """Stop receiving."""
        with contextlib.suppress(zenoh.ZError):  # a closed session has undeclared both
            self._states.undeclare()
            self._commands.undeclare()

    def _read_command(self, sample: zenoh.Sample) -> Any:
        """Return a command; None for an error record."""
        try:
            decoder = self._kind.decoders[protocol.select_codec(str(sample.encoding))]
            return decoder.decode(sample.payload.to_bytes())
        except (InvalidInput, msgspec.MsgspecError):
            return None

    def _keep_state(self, sample: zenoh.Sample) -> None:
        """Keep a state for its command."""
        with contextlib.suppress(InvalidInput):
            codec = protocol.select_codec(str(sample.encoding))
            state = self._kind.decode(sample.payload.to_bytes(), codec)
            self._waiting.pop(state.sequence, None)  # so that a repeated number is the newest
            self._waiting[state.sequence] = state


def _drain(subscriber: Any) -> list[zenoh.Sample]:
    """Return the waiting samples of a subscriber, the earliest first."""
    samples = []
    with contextlib.suppress(zenoh.ZError):  # closed
        while (sample := subscriber.handler.try_recv()) is not None:
            samples.append(sample)
    return samples


def _kind(setup: AnySetup) -> _Kind:
    """Return how the messages of a stream are read."""
    hand = setup.hand
    if isinstance(setup, PhaseStreamSetup):
        return _Kind(lambda payload, codec: PhaseState.decode(hand, payload, codec), _PHASE_DECODERS, PhaseStreamStep)
    if isinstance(setup, JointStreamSetup):
        return _Kind(lambda payload, codec: JointState.decode(setup, payload, codec), _JOINT_DECODERS, JointStreamStep)
    return _Kind(lambda payload, codec: StreamState.decode(hand, payload, codec), COMMAND_DECODERS, StreamStep)
