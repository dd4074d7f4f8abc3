"""The connection of a client's stream to its server over Zenoh."""

from __future__ import annotations

import contextlib

import zenoh
from zenoh.handlers import RingChannel

from graspforce.core.errors import ServiceError
from graspforce.service.zenoh_session import describe_zenoh_error


class ZenohConnection:
    """A publisher of states and a subscriber to commands.

    Zenoh stores the newest command in a ring of one, in its own thread. An arriving command wakes no Python thread.

    Args:
        session: an open session.
        key: key of the stream with its prefix; states go to ``<key>/state``, commands come from ``<key>/command``.
        codec: encoding of the states.
    """

    def __init__(self, session: zenoh.Session, key: str, codec: str) -> None:
        self._commands = session.declare_subscriber(f"{key}/command", RingChannel(1))
        self._take_newest = self._commands.handler.try_recv
        drop = zenoh.CongestionControl.DROP
        self._states = session.declare_publisher(f"{key}/state", encoding=codec, congestion_control=drop)

    def send(self, payload: bytes) -> None:
        """Publish a state without waiting.

        Raises:
            ServiceError: the stream or the session is closed.
        """
        try:
            self._states.put(payload)
        except zenoh.ZError as error:
            raise ServiceError(f"the stream is closed: {describe_zenoh_error(error)}") from None

    def receive(self) -> tuple[bytes, str] | None:
        """Return the payload and encoding of the newest unread command, or None. Does not wait."""
        try:
            sample = self._take_newest()
        except zenoh.ZError:  # closed
            return None
        return None if sample is None else (sample.payload.to_bytes(), str(sample.encoding))

    def close(self) -> None:
        """Stop publishing and receiving."""
        with contextlib.suppress(zenoh.ZError):  # a closed session has undeclared both
            self._commands.undeclare()
            self._states.undeclare()
