"""Which servers are alive, and why a connection or an answer is missing."""

from __future__ import annotations

import time
from collections.abc import Sequence

import zenoh

from graspforce.core.errors import NoServer, RequestRefused, ServerLost, ServiceError, ServiceTimeout
from graspforce.service.wire import protocol

_ALIVE_KEY = f"{protocol.PREFIX}/alive"
_RECONNECT_POLL = 0.02  # s


class ServerPresence:
    """The servers that a client can reach, by their liveliness tokens.

    Args:
        session: an open session.
        addresses: endpoints of the client, for messages.
        timeout: time to wait for a list of servers, s.
    """

    def __init__(self, session: zenoh.Session, addresses: Sequence[str], timeout: float) -> None:
        self._session, self._addresses, self._timeout = session, tuple(addresses), timeout
        # A liveliness subscriber would be simpler, but while Zenoh sets it up, queries of liveliness return nothing.
        self._was_reached = False

    def servers(self) -> tuple[str, ...]:
        """Return the ids of the servers that are alive; empty if there are none.

        Raises:
            ServiceTimeout: the list did not arrive in time.
            ServiceError: the client is closed.
        """
        found: list[str] = []
        try:
            replies = self._session.liveliness().get(f"{_ALIVE_KEY}/*", timeout=self._timeout)
        except zenoh.ZError:
            raise ServiceError("the client is closed") from None
        for reply in replies:
            if reply.ok is None:
                raise ServiceTimeout(
                    f"{describe_addresses(self._addresses)} did not list the servers within {self._timeout:g} s"
                )
            prefix, _, id = str(reply.ok.key_expr).rpartition("/")
            if prefix == _ALIVE_KEY and "*" not in id:  # a token whose key has wildcards is none of a server
                found.append(id)
        return tuple(sorted(found))

    def note_request(self) -> None:
        """Remember whether a server is connected. Call it before each request; it costs a microsecond."""
        self._was_reached = self._was_reached or bool(self._session.info.peers_zid())

    def note_answer(self) -> None:
        """Remember that a server has answered, maybe through a router."""
        self._was_reached = True

    def wait_for_replica(self, deadline: float) -> bool:
        """Return whether a server is alive. With several endpoints, wait until the session has connected to the next one.

        Args:
            deadline: latest time to wait, on the clock `time.monotonic`, s.
        """
        while not self.servers():
            if len(self._addresses) < 2 or time.monotonic() >= deadline:
                return False
            time.sleep(_RECONNECT_POLL)
        return time.monotonic() < deadline

    def explain_missing_answer(self, key: str) -> ServiceError:
        """Return the exception for a query without any reply.

        Args:
            key: key of the query after the prefix.
        """
        if self.servers():
            message = f"a server is alive, but {key} got no answer: the key is not permitted, or the connection broke"
            return RequestRefused("forbidden", message)
        if self._was_reached:
            self._was_reached = False
            where = describe_addresses(self._addresses)
            hint = ""
            if any(address.startswith(("tls/", "quic/")) for address in self._addresses):
                hint = "; a server that does not know the certificate permits nothing: restart it after `graspforce secure add`"
            return ServerLost(f"the server at {where} ended or was disconnected before it answered{hint}")
        return NoServer(f"no server is alive at {describe_addresses(self._addresses)}")


def describe_addresses(addresses: Sequence[str]) -> str:
    """Return endpoints as text.

    Args:
        addresses: the endpoints.
    """
    return " or ".join(addresses) or "the configured address"
