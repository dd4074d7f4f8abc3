"""The Zenoh configuration of a server: defaults, and endpoints that others in the network reach."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping

import zenoh

from graspforce.core.errors import InvalidInput
from graspforce.service.zenoh_session import build_configuration, exposed_endpoints

log = logging.getLogger("graspforce.service")

_DEFAULTS: dict[str, object] = {
    "mode": "peer",
    # µs until a client that does not read its replies is disconnected. Zenoh's 5 s would block a solver thread for that time.
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,
    # µs until a command is dropped if its client does not read. The next command is newer.
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
}


def server_configuration(config: str | os.PathLike[str] | None, endpoint: Mapping[str, object]) -> zenoh.Config:
    """Return the Zenoh configuration of a server.

    Args:
        config: as in `Server`.
        endpoint: settings that replace those of the file, such as ``"listen/endpoints"``.

    Raises:
        InvalidInput: the file cannot be read, or Zenoh rejects a setting.
    """
    return build_configuration(config, _DEFAULTS, endpoint)


def check_endpoints(config: zenoh.Config, insecure: bool) -> None:
    """Refuse endpoints beyond this machine without TLS, or warn of them.

    Args:
        config: the configuration of a server.
        insecure: whether such endpoints are allowed.

    Raises:
        InvalidInput: there is one, and it is not allowed.
    """
    exposed = exposed_endpoints(config)
    if exposed and not insecure:
        allowed = "an endpoint of this machine (tcp/127.0.0.1:…), one with TLS (tls/…)"
        raise InvalidInput("listen", exposed[0], f"{allowed}, or allowed with --insecure (insecure=True)")
    if exposed:
        log.warning("listening on %s without TLS: any program in the network can drive the hands", ", ".join(exposed))
