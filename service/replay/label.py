"""Postures in the recorded streams, and labels of the motions of their fingers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.hand.hand import Hand
from graspforce.learning.actions.labels import MotionLabel, label_motions
from graspforce.learning.actions.segmentation import GistSettings
from graspforce.service.recording.exchange import STATE, Exchange
from graspforce.service.recording.recording_reader import ServerRecording
from graspforce.service.wire import protocol
from graspforce.service.wire.stream_setups import read_setup
from graspforce.service.wire.stream_state import to_lists

_STREAMS = "streams/"
_MEASURED = ("state", "measurement", "measured")  # fields of a state with the posture, by kind of stream


@dataclass(frozen=True, slots=True)
class LabelledStream:
    """The motions of the fingers in a stream.

    Attributes:
        hand: name of the hand.
        start: time of the first state on the server's clock, s.
        labels: the labels; their times are on the server's clock, s.
    """

    hand: str
    start: float
    labels: tuple[MotionLabel, ...]


@dataclass(slots=True)
class StreamPostures:
    """Times and postures of a stream.

    Attributes:
        hand: the hand.
        t: times of the states on the server's clock, s.
        q: (n,) joint positions of each, rad.
    """

    hand: Hand
    t: list[float] = field(default_factory=list)
    q: list[list[float]] = field(default_factory=list)

    def array(self) -> Array:
        """Return the postures as an array (T, n), rad."""
        return np.reshape(np.array(self.q, dtype=np.float64), (len(self.t), self.hand.n))


def recorded_postures(recording: ServerRecording, hands: Mapping[str, Hand]) -> dict[str, StreamPostures]:
    """Return the postures in all streams of a recording, by the id of the stream.

    Args:
        recording: the recording.
        hands: its hands by name.
    """
    streams: dict[str, StreamPostures] = {}
    for exchange in recording.exchanges():
        if not exchange.ok:
            continue
        if exchange.kind != STATE and exchange.key.startswith(_STREAMS):
            _open(exchange, hands, streams)
        elif exchange.kind == STATE and exchange.key in streams:
            _add(exchange, streams[exchange.key])
    return streams


def label_recording(
    recording: ServerRecording, hands: Mapping[str, Hand], settings: GistSettings | None = None
) -> dict[str, LabelledStream]:
    """Return the motions of the fingers in all streams of a recording, by the id of the stream.

    Streams that are too short for a label are left out. An id that is opened anew continues its stream.

    Args:
        recording: the recording.
        hands: its hands by name.
        settings: parameters of the segmentation, as in `label_motions`.
    """
    found = {}
    for id, each in recorded_postures(recording, hands).items():
        try:
            labels = label_motions(each.hand, each.t, each.array(), settings=settings)
        except InvalidInput:
            continue  # too short
        found[id] = LabelledStream(each.hand.name, each.t[0], labels)
    return found


def _open(exchange: Exchange, hands: Mapping[str, Hand], streams: dict[str, StreamPostures]) -> None:
    """Begin the postures of a stream that is opened."""
    reply = protocol.decode(exchange.reply, exchange.reply_encoding)
    if not isinstance(reply, dict) or "opened" not in reply:
        return
    _, record = protocol.Envelope.split(protocol.decode(exchange.payload, protocol.select_codec(exchange.encoding)))
    id, setup = exchange.key.removeprefix(_STREAMS), read_setup(hands, record)
    if id not in streams or streams[id].hand.n != setup.hand.n:
        streams[id] = StreamPostures(setup.hand)


def _add(exchange: Exchange, stream: StreamPostures) -> None:
    """Append the posture of a state."""
    record = to_lists(protocol.decode(exchange.payload, protocol.select_codec(exchange.encoding)))
    for name in _MEASURED:
        part = record.get(name) if isinstance(record, dict) else None
        if isinstance(part, dict) and len(part.get("posture") or ()) == stream.hand.n:
            stream.t.append(exchange.received)
            stream.q.append(part["posture"])
            return
