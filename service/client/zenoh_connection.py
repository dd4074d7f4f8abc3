"""A stream's connection to its server over Zenoh."""

from __future__ import annotations

import contextlib

import zenoh
from zenoh.handlers import RingChannel

from graspforce.core.errors import ServiceError
from graspforce.service.zenoh_session import describe_zenoh_error


class ZenohConnection:
    """A stream's way to its server over Zenoh, which lays the newest command into a ring of one without Python."""

    def __init__(self, session: zenoh.Session, key: str, codec: str) -> None:
        self._commands = session.declare_subscriber(f"{key}/command", RingChannel(1))
        self._take = self._commands.handler.try_recv
        drop = zenoh.CongestionControl.DROP
        self._states = session.declare_publisher(f"{key}/state", encoding=codec, congestion_control=drop)

    def send(self, payload: bytes) -> None:
        try:
            self._states.put(payload)
        except zenoh.ZError as error:
            raise ServiceError(f"the stream is closed: {describe_zenoh_error(error)}") from None

    def receive(self) -> tuple[bytes, str] | None:
        try:
            sample = self._take()
        except zenoh.ZError:  # closed
            return None
        return None if sample is None else (sample.payload.to_bytes(), str(sample.encoding))

    def close(self) -> None:
        with contextlib.suppress(zenoh.ZError):  # a session that is closed has closed both
            self._commands.undeclare()
            self._states.undeclare()
