"""What a server receives and answers, as its recording keeps it."""

from __future__ import annotations

import platform
import time
from typing import TypeAlias

import msgspec
import numpy as np

import graspforce
from graspforce.core.json_text import JsonRecord
from graspforce.hand.hand import Hand
from graspforce.service.wire.reply import Reply

FORMAT = "graspforce/recording/1"
HEADER, END, DROPPED = "graspforce", "graspforce-end", "/dropped"  # names of metadata, and a topic
OTHER = "other"  # key of exchanges beyond the largest number of keys, without their contents
REQUEST, STATE = "request", "state"  # kinds of exchanges
LENGTH_BYTES = 4  # of the length before each message to the process that writes
_DIGITS = 9  # of the numbers in a hand's fingerprint


class Exchange(msgspec.Struct, array_like=True):
    """A request or a state with its reply.

    Args:
        kind: `REQUEST` or `STATE`.
        key: key of a request after the prefix, or id of a stream.
        received: when it arrived, on the server's clock `time.perf_counter`, s.
        sent: when its reply was sent, s.
        payload: the encoded request or state.
        encoding: its Zenoh encoding; None for none.
        ok: whether the reply is a record, not an error record.
        reply: the encoded reply.
        reply_encoding: its Zenoh encoding.
        dropped: number of exchanges of this stream, or of requests, that were dropped just before this one.
    """

    kind: str
    key: str
    received: float
    sent: float
    payload: bytes
    encoding: str | None
    ok: bool
    reply: bytes
    reply_encoding: str
    dropped: int = 0

    @property
    def source(self) -> str:
        """The stream, or all requests: gaps are counted for each."""
        return f"streams/{self.key}" if self.kind == STATE else "requests"


def recorded(kind: str, key: str, received: float, request: tuple[bytes, str | None], reply: Reply) -> Exchange:
    """Return the exchange of a reply that is sent now.

    Args:
        kind: `REQUEST` or `STATE`.
        key: key of a request after the prefix, or id of a stream.
        received: when the request or state arrived, on the clock `time.perf_counter`, s.
        request: its payload, and its Zenoh encoding or None.
        reply: the reply.
    """
    return Exchange(kind, key, received, time.perf_counter(), *request, reply.ok, reply.payload, reply.encoding)


class RecordedHand(msgspec.Struct):
    """A hand that the server has.

    Args:
        name: its name.
        file: name of the shipped hand, or path of the description, from which it was loaded.
        fingerprint: text that changes if its joints, limits, frames, masses or drives do.
    """

    name: str
    file: str
    fingerprint: str


class Header(msgspec.Struct, tag=True):
    """First message to the process that writes the recording.

    Args:
        clock: time since 1970 at zero of the server's clock, ns.
        version: version of graspforce.
        machine: processor, system and version of NumPy: answers of others may differ in the last digits.
        hands: the served hands.
        limits: the limits of the server by name.
    """

    clock: int
    version: str
    machine: str
    hands: tuple[RecordedHand, ...]
    limits: dict[str, int | float]


class Batch(msgspec.Struct, tag=True):
    """Exchanges to write.

    Args:
        exchanges: the exchanges, the earliest first.
    """

    exchanges: list[Exchange]


class End(msgspec.Struct, tag=True):
    """Last message: the recording is complete.

    Args:
        written: number of exchanges that were sent to the process.
        dropped: number of exchanges that were dropped, by stream.
    """

    written: int
    dropped: dict[str, int]


Message: TypeAlias = Header | Batch | End


def this_version() -> str:
    """Return the version of graspforce."""
    return graspforce.__version__


def this_machine() -> str:
    """Return processor, system and version of NumPy of this machine."""
    return f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}, NumPy {np.__version__}"


def recorded_hand(hand: Hand) -> RecordedHand:
    """Return the description of a hand for a recording.

    Args:
        hand: the hand.
    """
    return RecordedHand(hand.name, hand.file, fingerprint(hand))


def fingerprint(hand: Hand) -> str:
    """Return a text that changes if a hand changes, but not with the rounding of another machine.

    Args:
        hand: the hand.
    """
    from hashlib import sha256

    record: JsonRecord = {"description": hand.describe(), "masses": hand.mass_matrix(hand.neutral).tolist()}
    return sha256(msgspec.json.encode(_rounded(record))).hexdigest()


def _rounded(value: object) -> object:
    """Return a plain value with rounded numbers."""
    if isinstance(value, float):
        return f"{value:.{_DIGITS}g}" if abs(value) > 10.0**-_DIGITS else "0"
    if isinstance(value, dict):
        return {name: _rounded(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return value
