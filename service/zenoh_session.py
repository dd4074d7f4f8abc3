"""How a Zenoh session is set up, by the server and by its clients alike."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from typing import Any

import zenoh

from graspforce.core.errors import InvalidInput

DEFAULT_ADDRESS = "tcp/127.0.0.1:7450"

# Shared memory that Zenoh takes up by itself loses messages silently when the receiver stalls for 100 ms.
_BASE_SETTINGS: dict[str, Any] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/shared_memory/enabled": False,
}
_SOURCE_LOCATION = re.compile(r" at /\S+:\d+\.")  # where in Zenoh's sources an error arose


def build_configuration(
    config: str | os.PathLike[str] | None, defaults: Mapping[str, Any], overrides: Mapping[str, Any]
) -> zenoh.Config:
    """A Zenoh configuration.

    Args:
        config: path of a configuration file, which then says everything; None for ours.
        defaults: what is ours beside the quiet defaults, by key; not used with a file.
        always: what holds with a file too.

    Raises:
        InvalidInput: the file is not there, or not a Zenoh configuration.
    """
    if config is None:
        built: zenoh.Config = zenoh.Config()
        settings = {**_BASE_SETTINGS, **defaults, **overrides}
    else:
        try:
            built = zenoh.Config.from_file(os.fspath(config))
        except zenoh.ZError as error:
            raise InvalidInput(
                "config", os.fspath(config), f"a Zenoh configuration file ({describe_zenoh_error(error)})"
            ) from None
        settings = dict(overrides)
    for key, value in settings.items():
        try:
            built.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise InvalidInput(key, value, f"what Zenoh allows there ({describe_zenoh_error(error)})") from None
    return built


def describe_zenoh_error(error: zenoh.ZError) -> str:
    """What Zenoh says went wrong, without the places in its sources."""
    return _SOURCE_LOCATION.sub("", str(error)).strip()
