"""The Zenoh sessions that are connected to a server.

A client names its session in the attachment of its queries: the Zenoh id, in hexadecimal, maybe with ``/`` and a name. The
server knows the ids of the sessions that are connected to it; one client does not learn the ids of others. A name without a
connected session, of a client that writes none or is behind a router, belongs to the one session `OTHERS`. Names that a client
makes up therefore do not increase its share.
"""

from __future__ import annotations

import queue
from typing import NamedTuple

OTHERS = b""  # session of the clients that name no connected session
_MAX_NAME_BYTES = 64


class ClientName(NamedTuple):
    """Session and name of the client of a request.

    Attributes:
        session: id of its session, or `OTHERS`.
        name: the name that it gives itself within the session.
    """

    session: bytes
    name: bytes


class ClientSessions:
    """The connected sessions. Thread-safe: Zenoh's threads call `connect` and `disconnect`, others the rest.

    Attributes:
        ended: ids of sessions that have disconnected, in this order, `OTHERS` for a router; None ends the wait for them.
    """

    def __init__(self) -> None:
        self._connected: set[bytes] = set()
        self.ended: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()

    def connect(self, id: str, is_router: bool = False) -> None:
        """Add a session.

        Args:
            id: its Zenoh id in hexadecimal.
            is_router: whether it is a router, whose clients belong to `OTHERS`.
        """
        if not is_router:
            self._connected.add(id.encode())

    def disconnect(self, id: str, is_router: bool = False) -> None:
        """Remove a session.

        Args:
            id: its Zenoh id in hexadecimal.
            is_router: as in `connect`.
        """
        self._connected.discard(id.encode())
        self.ended.put(OTHERS if is_router else id.encode())

    def is_connected(self, session: bytes) -> bool:
        """Return whether a session is connected; true for `OTHERS`.

        Args:
            session: id of a session.
        """
        return session == OTHERS or session in self._connected

    def identify(self, attachment: bytes) -> ClientName:
        """Return session and name of the client of a request.

        Args:
            attachment: attachment of its query; empty for none.
        """
        session, _, name = attachment[:_MAX_NAME_BYTES].partition(b"/")
        if session and session in self._connected:
            return ClientName(session, name)
        return ClientName(OTHERS, attachment[:_MAX_NAME_BYTES])
