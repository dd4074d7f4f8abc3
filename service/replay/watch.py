"""Twins of streams that hold an object, recorded or running."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from graspforce.contact.contact import ContactSet
from graspforce.control import GraspState
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.estimation.motor_share import HeldState
from graspforce.estimation.twin import Twin, TwinReading, TwinSettings
from graspforce.hand.hand import Hand
from graspforce.service.client.stream_monitor import COMMAND_DECODERS, StreamMonitor, StreamStep
from graspforce.service.recording.exchange import STATE, Exchange
from graspforce.service.recording.recording_reader import ServerRecording
from graspforce.service.wire import protocol
from graspforce.service.wire.control_records import StreamSetup
from graspforce.service.wire.memory_records import to_array
from graspforce.service.wire.stream_setups import read_setup
from graspforce.service.wire.stream_state import StreamState

_STREAMS = "streams/"
_POLL = 0.05  # s, between two readings of the messages
_SILENCE = 1.0  # s without messages, after which to ask whether the stream is open


@dataclass(slots=True)
class WatchedStream:
    """A stream and its twin.

    Attributes:
        setup: its parameters.
        twin: its twin.
        states: number of states that the twin took.
        last: the last reading; None before the first.
        first_drift: the first reading with a drift; None without.
    """

    setup: StreamSetup
    twin: Twin
    states: int = 0
    last: TwinReading | None = field(default=None)
    first_drift: TwinReading | None = field(default=None)

    def add(self, step: StreamStep) -> TwinReading | None:
        """Give a step to the twin, and return its reading if it has one.

        Args:
            step: the step.
        """
        state = _held_state(self.setup, step)
        if state is None:
            return None
        self.states += 1
        reading = self.twin.add(state)
        if reading is not None:
            self.last = reading
            if reading.drifts and self.first_drift is None:
                self.first_drift = reading
        return reading

    def to_dict(self) -> JsonRecord:
        """Return a plain record."""
        readings = {"last": self.last, "first_drift": self.first_drift}
        shown = {name: None if each is None else each.to_dict() for name, each in readings.items()}
        return {"states": self.states, **shown, "minutes": [each.to_dict() for each in self.twin.minutes]}


def watch_recording(
    recording: ServerRecording,
    hands: Mapping[str, Hand],
    settings: TwinSettings | None = None,
    on_reading: Callable[[str, TwinReading], None] = lambda id, reading: None,
) -> dict[str, WatchedStream]:
    """Compare the recorded streams with the model. Streams whose states are measurements, phases or joints have no twin.

    Args:
        recording: the recording.
        hands: its hands by name.
        settings: limits of the twins.
        on_reading: called with the id of a stream and each reading.

    Returns:
        The streams by id.
    """
    streams: dict[str, WatchedStream] = {}
    for exchange in recording.exchanges():
        if exchange.ok and exchange.kind != STATE and exchange.key.startswith(_STREAMS):
            _open(exchange, hands, settings, streams)
        elif exchange.ok and exchange.kind == STATE and exchange.key in streams:
            stream = streams[exchange.key]
            step = _recorded_step(stream.setup, exchange)
            reading = None if step is None else stream.add(step)
            if reading is not None:
                on_reading(exchange.key, reading)
    return streams


def watch_stream(
    monitor: StreamMonitor,
    hands: Mapping[str, Hand],
    settings: TwinSettings | None = None,
    on_reading: Callable[[TwinReading], None] = lambda reading: None,
    goes_on: Callable[[], bool] = lambda: True,
    is_open: Callable[[], bool] = lambda: True,
) -> WatchedStream:
    """Compare a running stream with the model until it ends.

    Args:
        monitor: the monitor of the stream.
        hands: hands by name, with that of the stream.
        settings: limits of the twin.
        on_reading: called with each reading.
        goes_on: whether to go on; called twenty times a second.
        is_open: whether the stream is still open; called once a second without states.

    Returns:
        The stream, with its twin.

    Raises:
        InvalidInput: the stream controls no held object, or its states are measurements.
        UnknownName: its hand is not among `hands`.
    """
    setup = monitor.read_setup(hands)
    if setup.sensors is not None:
        raise InvalidInput("--stream", monitor.id, "a stream with exact states; this one has measurements")
    stream = WatchedStream(setup, Twin(setup.grasp, setup.settings.gravity_H, settings))
    last = time.monotonic()
    while goes_on():
        steps = monitor.take_all()
        for step in steps:
            reading = stream.add(step)
            if reading is not None:
                on_reading(reading)
        if steps:
            last = time.monotonic()
        elif time.monotonic() - last > _SILENCE:
            if not is_open():
                break
            last = time.monotonic()
        time.sleep(_POLL)
    return stream


def _open(
    exchange: Exchange, hands: Mapping[str, Hand], settings: TwinSettings | None, streams: dict[str, WatchedStream]
) -> None:
    """Make the twin of a stream that is opened."""
    reply = protocol.decode(exchange.reply, exchange.reply_encoding)
    if not isinstance(reply, dict) or reply.get("opened") is not True:
        return
    _, record = protocol.Envelope.split(protocol.decode(exchange.payload, protocol.select_codec(exchange.encoding)))
    setup = read_setup(hands, record)
    if isinstance(setup, StreamSetup) and setup.sensors is None:
        twin = Twin(setup.grasp, setup.settings.gravity_H, settings)
        streams[exchange.key.removeprefix(_STREAMS)] = WatchedStream(setup, twin)


def _recorded_step(setup: StreamSetup, exchange: Exchange) -> StreamStep | None:
    """Return a recorded state with its command; None if the state cannot be read."""
    try:
        state = StreamState.decode(setup.hand, exchange.payload, protocol.select_codec(exchange.encoding))
    except InvalidInput:
        return None
    return StreamStep(state, COMMAND_DECODERS[exchange.reply_encoding].decode(exchange.reply))


def _held_state(setup: StreamSetup, step: StreamStep) -> HeldState | None:
    """Return the state of a stream with its commanded torques; None if other contacts hold the object."""
    state, command = step.state, step.command
    change = command.contact_change
    if not isinstance(state.state, GraspState) or (change is not None and change.number > setup.change_number):
        return None
    known = setup.grasp.contacts
    frames = to_array(command.memory.frames, -1, 3, 3)
    limits = known.models, known.mu, known.gamma, known.min_normal, known.max_normal
    contacts = ContactSet(to_array(command.positions, -1, 3), frames, *limits)
    motion = state.state.object
    return HeldState(state.time, state.state.q, state.state.v, motion, to_array(command.torque), contacts)
