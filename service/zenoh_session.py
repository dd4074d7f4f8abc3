"""Zenoh configuration of the server and its clients.

Scouting is off: a server listens on one endpoint, and clients connect to it. A configuration file replaces all defaults.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping

import zenoh

from graspforce.core.errors import InvalidInput

DEFAULT_ADDRESS = "tcp/127.0.0.1:7450"  # not 7447: the Zenoh router of ROS 2 listens there

MAX_MESSAGE_BYTES = 8 * 2**20  # of the payload of a query, a state or a reply
_ENVELOPE_BYTES = 4096  # of a Zenoh message beside its payload
# Zenoh's automatic shared memory drops messages without an error if the receiver stalls for 100 ms.
_BASE_SETTINGS: dict[str, object] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/shared_memory/enabled": False,
    "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES + _ENVELOPE_BYTES,
}
_SOURCE_LOCATION = re.compile(r" at /\S+:\d+\.")  # place in Zenoh's source code at the end of its messages


def build_configuration(
    config: str | os.PathLike[str] | None, defaults: Mapping[str, object], overrides: Mapping[str, object]
) -> zenoh.Config:
    """Build a Zenoh configuration from a file or from the defaults.

    Args:
        config: path of a Zenoh configuration file; None for graspforce's defaults.
        defaults: settings by key, such as ``"mode"``; ignored if there is a file.
        overrides: settings by key; they apply with and without a file.

    Returns:
        The configuration.

    Raises:
        InvalidInput: the file cannot be read, or Zenoh rejects a setting.
    """
    if config is None:
        built: zenoh.Config = zenoh.Config()
        settings = {**_BASE_SETTINGS, **defaults, **overrides}
    else:
        try:
            built = zenoh.Config.from_file(os.fspath(config))
        except zenoh.ZError as error:
            reason = describe_zenoh_error(error)
            raise InvalidInput("config", os.fspath(config), f"a Zenoh configuration file ({reason})") from None
        settings = dict(overrides)
    for key, value in settings.items():
        try:
            built.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise InvalidInput(key, value, f"a value that Zenoh accepts ({describe_zenoh_error(error)})") from None
    return built


def connect_endpoints(config: zenoh.Config) -> tuple[str, ...]:
    """Return the endpoints that a client with a configuration connects to.

    Args:
        config: the configuration of a client.
    """
    endpoints = json.loads(config.get_json("connect/endpoints"))
    return tuple(endpoints if isinstance(endpoints, list) else endpoints.get("client", ()))


def find_addresses(session: zenoh.Session, config: zenoh.Config) -> tuple[str, ...]:
    """Return the endpoints at which a session listens.

    Args:
        session: an open session; with ``adminspace/enabled`` it tells the ports that it selected.
        config: its configuration.
    """
    for reply in session.get(f"@/{session.zid()}/*", timeout=1.0):
        if reply.ok is not None:
            return tuple(json.loads(reply.ok.payload.to_bytes())["locators"])
    endpoints = json.loads(config.get_json("listen/endpoints"))
    return tuple(endpoints if isinstance(endpoints, list) else endpoints["peer"])


def describe_zenoh_error(error: zenoh.ZError) -> str:
    """Return the text of a Zenoh error without locations in Zenoh's source code."""
    return _SOURCE_LOCATION.sub("", str(error)).strip()
