"""Zenoh configuration of the server and its clients.

Scouting is off: a server listens on one endpoint, and clients connect to it. The settings of a configuration file replace the
defaults of the same keys; the other defaults stay.
"""

from __future__ import annotations

import ipaddress
import json
import os
import re
from collections.abc import Mapping

import zenoh

from graspforce.core.errors import InvalidInput
from graspforce.service.wire import protocol

MSGPACK_ENCODING = zenoh.Encoding(protocol.MSGPACK)
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
_SECURE_LINKS = ("tls", "quic", "wss", "unixsock-stream")
_SECRETS = ("password", "listen_private_key_base64", "connect_private_key_base64")
_SOURCE_LOCATION = re.compile(r" at /\S+:\d+\.")  # place in Zenoh's source code at the end of its messages
_PARSER_MESSAGE = re.compile(r'msg: "((?:[^"\\]|\\.)*)"')  # in the errors of Zenoh's parser


def build_configuration(
    config: str | os.PathLike[str] | None, defaults: Mapping[str, object], overrides: Mapping[str, object]
) -> zenoh.Config:
    """Build a Zenoh configuration from a file or from the defaults.

    Args:
        config: path of a Zenoh configuration file, JSON or JSON5; None for graspforce's defaults.
        defaults: settings by key, such as ``"mode"``. A setting of the file replaces the one of the same key.
        overrides: settings by key; they replace those of the file.

    Returns:
        The configuration.

    Raises:
        InvalidInput: the file cannot be read, or Zenoh rejects a setting.
    """
    settings = {**_BASE_SETTINGS, **defaults}
    if config is None:
        built: zenoh.Config = zenoh.Config()
    else:
        built, given = _read_file(os.fspath(config))
        settings = {key: value for key, value in settings.items() if not _is_given(given, key)}
    settings |= overrides
    for key, value in settings.items():
        try:
            built.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise InvalidInput(key, value, f"a value that Zenoh accepts ({describe_zenoh_error(error)})") from None
    return built


def show_configuration(config: zenoh.Config) -> str:
    """Return a configuration as JSON text, without passwords and private keys.

    Args:
        config: the configuration.
    """
    return json.dumps(_without_secrets(json.loads(str(config))), indent=2)


def exposed_endpoints(config: zenoh.Config) -> tuple[str, ...]:
    """Return the endpoints beyond its own machine at which a server listens, or which it connects to, without TLS.

    Args:
        config: the configuration of a server.
    """
    endpoints = [*_endpoints(config, "listen"), *_endpoints(config, "connect")]
    return tuple(endpoint for endpoint in endpoints if not _is_protected(endpoint))


def unsecured_listeners(config: zenoh.Config) -> tuple[str, ...]:
    """Return the endpoints without TLS at which a server listens, also those of its own machine.

    Args:
        config: the configuration of a server.
    """
    return tuple(each for each in _endpoints(config, "listen") if each.partition("/")[0] not in _SECURE_LINKS)


def _endpoints(config: zenoh.Config, kind: str) -> list[str]:
    """Return the endpoints of a configuration to listen at, or to connect to, for all modes of a session."""
    listed = json.loads(config.get_json(f"{kind}/endpoints"))
    return listed if isinstance(listed, list) else [each for some in listed.values() for each in some]


def _is_protected(endpoint: str) -> bool:
    """Return whether an endpoint has TLS, or is of this machine only."""
    link, _, rest = endpoint.partition("/")
    if link in _SECURE_LINKS:
        return True
    host = rest.partition("?")[0].partition("#")[0].rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _read_file(path: str) -> tuple[zenoh.Config, object]:
    """Return the configuration of a file, and the settings that the file has."""
    import json5  # imported here, because only servers and clients with a file need it

    try:
        built = zenoh.Config.from_file(path)
        with open(path, encoding="utf-8") as file:
            return built, json5.load(file)
    except zenoh.ZError as error:
        reason = describe_zenoh_error(error)
    except (ValueError, OSError) as error:
        reason = str(error)
    raise InvalidInput("config", path, f"a Zenoh configuration file in JSON or JSON5 ({reason})") from None


def _is_given(settings: object, key: str) -> bool:
    """Return whether a file has a setting, or a value in place of a part of its key."""
    for name in key.split("/"):
        if not isinstance(settings, Mapping):
            return True
        if name not in settings:
            return False
        settings = settings[name]
    return True


def _without_secrets(value: object) -> object:
    """Return settings with the values of passwords and private keys hidden."""
    if isinstance(value, list):
        return [_without_secrets(item) for item in value]
    if not isinstance(value, dict):
        return value
    hidden = {name for name in value if name in _SECRETS and value[name] is not None}
    return {name: "(hidden)" if name in hidden else _without_secrets(item) for name, item in value.items()}


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


def read_encoding(encoding: zenoh.Encoding) -> str:
    """Return the text of an encoding. It takes a fraction of the time of `str` for MessagePack.

    Args:
        encoding: encoding of a message.
    """
    return protocol.MSGPACK if encoding == MSGPACK_ENCODING else str(encoding)


def describe_zenoh_error(error: zenoh.ZError) -> str:
    """Return the text of a Zenoh error in one line, without locations in Zenoh's source code."""
    text = " ".join(_SOURCE_LOCATION.sub("", str(error)).split())
    found = _PARSER_MESSAGE.search(text)
    return found[1] if found is not None else text
