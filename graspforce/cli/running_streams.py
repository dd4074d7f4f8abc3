"""Running streams of a service: which one a command means, its hand, and whether it is still open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from graspforce.core.errors import ErrorReply, InvalidInput
from graspforce.hand.hand import Hand
from graspforce.service import Client


def load_named(files: Sequence[str], name: str) -> Mapping[str, Hand]:
    """Return the hand of a stream by its name.

    Args:
        files: names or description files of hands.
        name: its name; a shipped hand if it is not among the files.

    Raises:
        UnknownName: a hand is not found: give its description file.
        ModelError: a hand cannot be read.
    """
    given = {hand.name: hand for hand in map(Hand.load, files)}
    return given if name in given else {name: Hand.load(name)}


def choose_stream(client: Client, id: str | None) -> str:
    """Return the id of the stream to follow.

    Args:
        client: the client of the service.
        id: the wanted id; None for the only open stream.

    Raises:
        InvalidInput: no stream is open, or several are and none is named.
    """
    if id is not None:
        return id
    found = [each.id for each in client.status().active_streams]
    if len(found) != 1:
        allowed = f"one of the open streams: {', '.join(found)}" if found else "the id of an open stream; none is open"
        raise InvalidInput("--stream", None, allowed)
    return found[0]


def is_stream_open(client: Client, id: str) -> bool:
    """Return whether a stream is open.

    Args:
        client: the client of the service.
        id: id of the stream.
    """
    try:
        client.monitor_stream(id).close()
    except ErrorReply:
        return False
    return True
