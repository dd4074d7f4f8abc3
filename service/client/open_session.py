"""The Zenoh session of a client, and the reason why it cannot be opened."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Mapping, Sequence

import zenoh

from graspforce.core.errors import NoServer, RequestRefused, ServiceError, ServiceTimeout
from graspforce.service.client.server_presence import describe_addresses
from graspforce.service.zenoh_session import DEFAULT_ADDRESS, build_configuration, connect_endpoints

_DEFAULT_SECURE_ADDRESS = "tls/localhost:7450"
_PROBE_TIMEOUT = 0.3  # s, to connect to a port that may listen
_STREAM_PROTOCOLS = ("tcp", "tls", "ws", "wss")  # links over TCP, whose port can be probed
# The client finds a restarted server within about a second. A state that does not fit into the queue is dropped at once.
_DEFAULTS: dict[str, object] = {
    "mode": "client",
    "connect/timeout_ms": 0,
    "connect/retry": {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 2},
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
}


def open_session(
    connect: str | Sequence[str] | None, config: str | os.PathLike[str] | None, timeout: float, tls: Mapping[str, object]
) -> tuple[zenoh.Session, tuple[str, ...]]:
    """Open the session of a client, and return it with the endpoints that it connects to.

    Args:
        connect: as in `Client`.
        config: as in `Client`.
        timeout: as in `Client`, s.
        tls: settings of TLS; empty for none.

    Raises:
        NoServer: as in `Client`.
        ServiceTimeout: as in `Client`.
        RequestRefused: as in `Client`.
        InvalidInput: the configuration file is invalid.
    """
    address = _DEFAULT_SECURE_ADDRESS if tls else DEFAULT_ADDRESS
    given = [connect] if isinstance(connect, str) else list(connect or ([address] if config is None else []))
    overrides = {**tls, **({"connect/endpoints": given} if given else {})}
    milliseconds = max(round(timeout * 1e3), 1)
    settings = build_configuration(config, {**_DEFAULTS, "transport/unicast/open_timeout": milliseconds}, overrides)
    addresses = tuple(given) or connect_endpoints(settings)
    start = time.monotonic()
    try:
        return zenoh.open(settings), addresses
    except zenoh.ZError:
        raise _explain_failed_open(addresses, time.monotonic() - start, timeout) from None


def _explain_failed_open(addresses: Sequence[str], waited: float, timeout: float) -> ServiceError:
    """Return the exception for a session that could not be opened.

    Args:
        addresses: endpoints of the client.
        waited: time since the attempt began, s.
        timeout: largest such time, s.
    """
    if waited >= timeout:
        return ServiceTimeout(f"no answer from {describe_addresses(addresses)} within {timeout:g} s of opening")
    for address in addresses:
        if _is_listening(address):
            reason = "check the TLS certificates of both sides, and that both use the same protocol"
            return RequestRefused("forbidden", f"a program listens at {address}, but refused the connection: {reason}")
    return NoServer(f"no server at {describe_addresses(addresses)}: start one with `graspforce serve`")


def _is_listening(address: str) -> bool:
    """Return whether a program listens at an endpoint; False if its link is not over TCP."""
    link, _, rest = address.partition("/")
    host, _, port = rest.partition("?")[0].partition("#")[0].rpartition(":")
    if link not in _STREAM_PROTOCOLS or not port.isdecimal():
        return False
    try:
        socket.create_connection((host.strip("[]"), int(port)), _PROBE_TIMEOUT).close()
    except (OSError, OverflowError, UnicodeError):
        return False
    return True
