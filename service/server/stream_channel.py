"""A control stream on the network."""

from __future__ import annotations

import logging
import threading

import zenoh
from zenoh.handlers import RingChannel

from graspforce.service.server.stream_registry import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.zenoh_session import describe_zenoh_error

log = logging.getLogger("graspforce.service")

_GRACE = 5.0  # s to finish the current command when the stream closes


class StreamChannel:
    """A control stream on the network: its states come in, its commands go out, on a thread of its own."""

    def __init__(self, session: zenoh.Session, stream: ServerStream) -> None:
        key = f"{protocol.PREFIX}/streams/{stream.id}"
        self._stream = stream
        self._commands = session.declare_publisher(f"{key}/command", congestion_control=zenoh.CongestionControl.DROP)
        self._states = session.declare_subscriber(f"{key}/state", RingChannel(1))
        self._thread = threading.Thread(target=self._run, name=f"stream-{stream.id}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Take no more states, and wait for the command that is being worked out."""
        self._states.undeclare()
        self._thread.join(_GRACE)
        self._commands.undeclare()

    def _run(self) -> None:
        take, put, command = self._states.handler.recv, self._commands.put, self._stream.command
        while True:
            try:
                sample = take()
            except zenoh.ZError:  # closed
                return
            reply = command(sample.payload.to_bytes(), str(sample.encoding))
            try:
                put(reply.payload, encoding=reply.encoding)
            except zenoh.ZError as error:
                log.warning("a command of stream %s could not be sent: %s", self._stream.id, describe_zenoh_error(error))
