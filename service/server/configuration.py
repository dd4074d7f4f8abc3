"""The Zenoh configuration of a server: defaults, and endpoints that others in the network reach."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Sequence

import zenoh

from graspforce.core import arrays
from graspforce.core.errors import InvalidInput
from graspforce.service.security.directory import server_settings
from graspforce.service.wire import protocol
from graspforce.service.zenoh_session import (
    DEFAULT_ADDRESS,
    build_configuration,
    connect_endpoints,
    exposed_endpoints,
    unsecured_listeners,
)

log = logging.getLogger("graspforce.service")

REPLICA_LEASE = 0.5  # s, default of servers that join a router
DEFAULT_SECURE_ADDRESS = "tls/0.0.0.0:7450"
_DEFAULTS: dict[str, object] = {
    "mode": "peer",
    # µs until a client that does not read its replies is disconnected. Zenoh's 5 s would block a solver thread for that time.
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,
    # µs until a command is dropped if its client does not read. The next command is newer.
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
}
# No other session gets queries of clients: it could answer them, and learn the ids of sessions and the proofs of ownership. Nor
# does it count as a server.
_GUARD: dict[str, object] = {
    "access_control": {
        "enabled": True,
        "default_permission": "allow",
        "rules": [
            {
                "id": "queryables of others",
                "permission": "deny",
                "flows": ["ingress"],
                "messages": ["declare_queryable"],
                "key_exprs": ["**"],
            },
            {
                "id": "queries to others",  # a session in the mode of a router would get all without declaring anything
                "permission": "deny",
                "flows": ["egress"],
                "messages": ["query"],
                "key_exprs": ["**"],
            },
            {
                "id": "tokens of others",
                "permission": "deny",
                "flows": ["ingress"],
                "messages": ["liveliness_token"],
                "key_exprs": [f"{protocol.NAMESPACE}/*/alive/**"],
            },
        ],
        "subjects": [{"id": "others"}],
        "policies": [{"rules": ["queryables of others", "queries to others", "tokens of others"], "subjects": ["others"]}],
    }
}


def server_configuration(
    config: str | os.PathLike[str] | None,
    listen: str | None = None,
    secure: str | os.PathLike[str] | None = None,
    connect: Sequence[str] = (),
    lease: float | None = None,
) -> zenoh.Config:
    """Return the Zenoh configuration of a server.

    A server that clients connect to directly lets no other session answer their queries. A router has to allow it, and so has a
    server that joins a router.

    Args:
        config: as in `Server`.
        listen: as in `Server`.
        secure: as in `Server`.
        connect: as in `Server`.
        lease: as in `Server`, s; None for Zenoh's.

    Raises:
        InvalidInput: a file cannot be read, Zenoh rejects a setting, or the lease is not positive.
    """
    overrides: dict[str, object] = {} if secure is None else server_settings(secure)
    if listen is None and (config is None or secure is not None):
        listen = DEFAULT_ADDRESS if secure is None else DEFAULT_SECURE_ADDRESS
    if listen is not None:
        overrides["listen/endpoints"] = [listen]
        if listen.endswith(":0"):
            overrides["adminspace/enabled"] = True  # to read the port that Zenoh selected
    if connect:
        overrides["connect/endpoints"] = list(connect)
    if lease is not None:
        overrides["transport/link/tx/lease"] = max(round(1e3 * arrays.check_number(lease, "lease", above=0.0)), 1)  # ms
    guarded = build_configuration(config, {**_DEFAULTS, **_GUARD}, overrides)
    if json.loads(guarded.get_json("mode")) == "peer" and not connect_endpoints(guarded):
        return guarded
    return build_configuration(config, _DEFAULTS, overrides)


def check_endpoints(config: zenoh.Config, insecure: bool, secure: bool = False) -> None:
    """Refuse endpoints and routers beyond this machine without TLS, or warn of them.

    Args:
        config: the configuration of a server.
        insecure: whether such endpoints are allowed.
        secure: whether the server has certificates; then it may listen only with TLS.

    Raises:
        InvalidInput: there is one, and it is not allowed.
    """
    unsecured = unsecured_listeners(config) if secure else ()
    if unsecured and not insecure:
        allowed = "an endpoint with TLS (tls/…), which --secure needs, or allowed with --insecure (insecure=True)"
        raise InvalidInput("listen", unsecured[0], allowed)
    exposed = exposed_endpoints(config)
    if exposed and not insecure:
        allowed = "an endpoint of this machine (tcp/127.0.0.1:…), one with TLS (tls/…)"
        field = "connect" if exposed[0] in connect_endpoints(config) else "listen"
        raise InvalidInput(field, exposed[0], f"{allowed}, or allowed with --insecure (insecure=True)")
    if exposed:
        log.warning("reachable at %s without TLS: any program in the network can drive the hands", ", ".join(exposed))
