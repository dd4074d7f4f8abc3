"""The connection of a client's stream to its server over Zenoh."""

from __future__ import annotations

import contextlib
from collections import Counter

import zenoh
from zenoh.handlers import RingChannel

from graspforce.core.errors import ServiceError
from graspforce.service.wire.stream_authentication import COMMAND, STATE, MessageSigner, MessageVerifier
from graspforce.service.zenoh_session import describe_zenoh_error, read_encoding

_RING_SIZE = 16  # commands; forged ones fill the ring beside the genuine one


class ZenohConnection:
    """A publisher of states and a subscriber to commands.

    Zenoh stores the newest commands in a ring, in its own thread. An arriving command wakes no Python thread.

    Args:
        session: an open session.
        key: key of the stream with its prefix; states go to ``<key>/state``, commands come from ``<key>/command``.
        codec: encoding of the states.

    Attributes:
        refused: number of refused commands by reason: "forged" or "replayed".
    """

    def __init__(self, session: zenoh.Session, key: str, codec: str) -> None:
        self._commands = session.declare_subscriber(f"{key}/command", RingChannel(_RING_SIZE))
        self._take_next = self._commands.handler.try_recv
        drop = zenoh.CongestionControl.DROP
        self._states = session.declare_publisher(f"{key}/state", encoding=codec, congestion_control=drop)
        self._key: bytes | None = None
        self._signer: MessageSigner | None = None
        self._verifier: MessageVerifier | None = None
        self.refused: Counter[str] = Counter()

    def authenticate(self, key: bytes) -> None:
        """Sign states and verify commands from now on, with the key of an opening. The present key changes nothing.

        Args:
            key: the key.
        """
        if key == self._key:
            return
        verifier = MessageVerifier(key, COMMAND)
        verifier.refused = self.refused
        self._key, self._signer, self._verifier = key, MessageSigner(key, STATE), verifier

    def send(self, payload: bytes) -> None:
        """Publish a state without waiting.

        Raises:
            ServiceError: the stream or the session is closed.
        """
        try:
            self._states.put(payload, attachment=None if self._signer is None else self._signer.sign(payload))
        except zenoh.ZError as error:
            raise ServiceError(f"the stream is closed: {describe_zenoh_error(error)}") from None

    def receive(self) -> tuple[bytes, str] | None:
        """Return the payload and encoding of the newest unread command that is genuine, or None. Does not wait."""
        newest = None
        try:
            while (sample := self._take_next()) is not None:
                payload, attachment = sample.payload.to_bytes(), sample.attachment
                code = b"" if attachment is None else attachment.to_bytes()
                if self._verifier is None or self._verifier.accept(payload, code):
                    newest = payload, read_encoding(sample.encoding)
        except zenoh.ZError:  # closed
            return newest
        return newest

    def close(self) -> None:
        """Stop publishing and receiving."""
        with contextlib.suppress(zenoh.ZError):  # a closed session has undeclared both
            self._commands.undeclare()
            self._states.undeclare()
