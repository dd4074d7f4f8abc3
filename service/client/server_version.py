"""Whether a server of another version can do what a request needs."""

from __future__ import annotations

from collections.abc import Sequence

import graspforce
from graspforce.core.errors import IncompatibleServer
from graspforce.service.wire import protocol
from graspforce.service.wire.status_records import ServerStatus


def check_server(status: ServerStatus, capabilities: Sequence[str]) -> None:
    """Check the version of the wire and the capabilities of a server.

    Args:
        status: its status.
        capabilities: names of those that a request needs.

    Raises:
        IncompatibleServer: it has another version of the wire, or lacks one of the capabilities.
    """
    ours, theirs = f"this client (graspforce {graspforce.__version__})", f"the server (graspforce {status.version})"
    if protocol.VERSION not in status.versions:
        versions = ", ".join(status.versions)
        raise IncompatibleServer(f"{theirs} has version {versions} of the wire, {ours} version {protocol.VERSION}")
    missing = [name for name in capabilities if name not in status.capabilities]
    if missing:
        raise IncompatibleServer(f"{theirs} lacks {', '.join(missing)}, which {ours} needs: update the server")
