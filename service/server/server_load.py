"""The load of a server: waiting requests, memory, and whether it can take work."""

from __future__ import annotations

import hashlib
import os
import resource
from collections.abc import Mapping
from typing import NamedTuple

from graspforce.service.server.client_sessions import OTHERS

_LABEL_DIGITS = 8
_PAGE = os.sysconf("SC_PAGE_SIZE")  # bytes


class ServerLoad(NamedTuple):
    """Load of a server.

    Attributes:
        waiting: requests that wait for a solver thread.
        queue_bytes: bytes of all waiting requests.
        clients: number of waiting requests by session of the client.
        problem: why the server cannot take work: it is closing, or a thread does not finish; None if it can.
        addresses: Zenoh endpoints at which clients reach it.
    """

    waiting: int = 0
    queue_bytes: int = 0
    clients: Mapping[bytes, int] = {}
    problem: str | None = None
    addresses: tuple[str, ...] = ()


def client_label(session: bytes) -> str:
    """Return a label of a client that does not tell its session, by which clients prove who they are.

    Args:
        session: id of the session, or `OTHERS`.
    """
    return "others" if session == OTHERS else hashlib.sha256(session).hexdigest()[:_LABEL_DIGITS]


def resident_bytes() -> int:
    """Return the resident memory of this process, bytes; where the system does not tell it, the largest so far."""
    try:
        with open("/proc/self/statm", "rb") as file:
            return int(file.read().split()[1]) * _PAGE
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # bytes on macOS, the only such system that is supported
