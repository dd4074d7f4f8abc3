"""Directories with the certificates and roles of a service. `graspforce secure` writes them, servers and clients read them.

| file                       | content                                                      |
|----------------------------|--------------------------------------------------------------|
| ``ca.pem``                 | certificate of the private authority; every machine needs it |
| ``ca.key``                 | its key; keep it off the robots                              |
| ``server.pem``, ``.key``   | certificate and key of the server                            |
| ``NAME.pem``, ``NAME.key`` | certificate and key of a client                              |
| ``roles.json``             | role of each client: "controller" or "monitor"               |
| ``NAME.json5``             | Zenoh configuration of the server or of a client             |

Controllers may use all keys. Monitors may ask for status, schemas, descriptions, poses and setups of streams, and follow the
messages of streams. Nobody but the server answers
queries, publishes commands or has its liveliness token.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from graspforce.core import fields
from graspforce.core.errors import InvalidInput
from graspforce.core.whole_file import write_text
from graspforce.service.wire import protocol

CONTROLLER, MONITOR = "controller", "monitor"
ROLES = (CONTROLLER, MONITOR)
SERVER = "server"
DEFAULT_HOSTS = ("localhost", "127.0.0.1")
_MAX_SESSIONS = 64  # connections of clients
_SIZE_LIMITS = {"look": 64 * 2**10, "states": 66 * 2**10, "plans": 128 * 2**10}  # bytes of messages, with their attachment
_ROLES_FILE = "roles.json"
_CLIENT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")  # fit for certificates, file names and keys
_ALL = f"{protocol.NAMESPACE}/**"
_MONITOR_KEYS = [f"{protocol.PREFIX}/{key}" for key in ("status", "hands/*", "hands/*/forward", "schema/**", "setups/**")]
_CONTROLLER_KEYS = [f"{protocol.PREFIX}/{key}" for key in ("*", "hands/**", "schema/**", "setups/**")]
_STREAM_MESSAGES = [f"{protocol.PREFIX}/streams/**/{name}" for name in ("state", "command")]


def init_directory(path: str | os.PathLike[str], hosts: Sequence[str] = ()) -> Path:
    """Make a certificate authority, and certificates of the server, a controller and a monitor.

    Args:
        path: a new directory, or one without keys, certificates and roles.
        hosts: names and addresses by which clients reach the server, beside localhost.

    Raises:
        InvalidInput: the directory has files of an earlier call, even if the authority's key is elsewhere.
        OSError: a file cannot be written.
    """
    from graspforce.service.security.certificates import issue_certificate, make_authority

    directory = Path(path)
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    if any(each.suffix in (".key", ".pem") or each.name == _ROLES_FILE for each in directory.iterdir()):
        raise InvalidInput("directory", str(directory), "a directory without keys, certificates and roles")
    make_authority(directory)
    issue_certificate(directory, SERVER, (*DEFAULT_HOSTS, *hosts))
    for role in ROLES:
        add_client(directory, role, role)
    return directory


def renew_server(path: str | os.PathLike[str], hosts: Sequence[str] = ()) -> None:
    """Issue a new certificate for the server, with the names and addresses of the present one.

    Args:
        path: directory of the certificate authority.
        hosts: further names and addresses by which clients reach the server.

    Raises:
        InvalidInput: the directory has no certificate authority.
        OSError: a file cannot be written.
    """
    from graspforce.service.security.certificates import hosts_of, issue_certificate

    directory = _check_authority(path)
    issue_certificate(directory, SERVER, tuple(dict.fromkeys((*hosts_of(directory, SERVER), *hosts))))


def begin_rotation(path: str | os.PathLike[str]) -> None:
    """Make a new certificate authority beside the present one, which stays valid until `finish_rotation`.

    Copy ``ca.pem``, which has both, to all machines and restart the server. Then issue all certificates again.

    Args:
        path: directory of the certificate authority.

    Raises:
        InvalidInput: the directory has no certificate authority, or a rotation that is not finished.
        OSError: a file cannot be written.
    """
    from graspforce.service.security import certificates

    directory = _check_authority(path)
    if certificates.is_rotating(directory):
        raise InvalidInput(
            "directory", str(directory), "one whose last rotation is finished: `graspforce secure rotate --finish`"
        )
    certificates.begin_rotation(directory)


def finish_rotation(path: str | os.PathLike[str]) -> None:
    """Remove the earlier certificate authority: its certificates are invalid when the server starts again.

    Args:
        path: directory of the certificate authority.

    Raises:
        InvalidInput: the directory has no certificate authority, or certificates of the earlier one.
        OSError: a file cannot be written.
    """
    from graspforce.service.security import certificates

    directory = _check_authority(path)
    names = (SERVER, *_read_roles(directory))
    old = [name for name in names if not certificates.is_issued_by_newest(directory, name)]
    if old:
        raise InvalidInput("directory", str(directory), f"one whose certificates are renewed; still old: {', '.join(old)}")
    certificates.end_rotation(directory)


def add_client(path: str | os.PathLike[str], name: str, role: str | None = None) -> str:
    """Issue a certificate for a client. An existing one of this name is replaced: this is how certificates are renewed.

    Args:
        path: directory of the certificate authority.
        name: name of the client, the common name of its certificate: letters, digits, and . _ - after the first character.
        role: "controller" or "monitor". Default: the present role of the client; "monitor" for a new one.

    Returns:
        The role.

    Raises:
        InvalidInput: the name or the role is not allowed, the directory has no certificate authority, or the file of roles is
            missing or invalid.
        OSError: a file cannot be written.
    """
    from graspforce.service.security.certificates import AUTHORITY, issue_certificate

    name = protocol.check_id(name, "name")
    if not _CLIENT_NAME.fullmatch(name):
        raise InvalidInput("name", name, "letters, digits, and . _ - after the first character")
    if name in (SERVER, AUTHORITY):
        raise InvalidInput("name", name, f"another name than {SERVER} and {AUTHORITY}")
    if role is not None:
        fields.check_choice(role, "role", ROLES)
    directory = _check_authority(path)
    own = {f"{each}.pem" for each in (SERVER, AUTHORITY)}
    has_clients = any(each.name not in own for each in directory.glob("*.pem"))
    roles = _read_roles(directory) if has_clients or (directory / _ROLES_FILE).exists() else {}
    role = role or roles.get(name, MONITOR)
    issue_certificate(directory, name)
    roles[name] = role
    write_text(directory / _ROLES_FILE, json.dumps(roles, indent=2) + "\n")
    server = {"mode": "peer", "listen/endpoints": ["tls/0.0.0.0:7450"], **server_settings(directory)}
    _write_configuration(directory / f"{SERVER}.json5", server)
    client = {"mode": "client", "connect/endpoints": ["tls/localhost:7450"], **client_settings(directory, name)}
    _write_configuration(directory / f"{name}.json5", client)
    return role


def server_settings(path: str | os.PathLike[str]) -> dict[str, object]:
    """Return the Zenoh settings of a server: mutual TLS, and access rules by the names of the clients' certificates.

    Args:
        path: directory with its certificate, and the roles.

    Raises:
        InvalidInput: a file is missing or invalid.
    """
    directory = Path(path)
    files = _certificate_files(directory, SERVER)
    roles = _read_roles(directory)
    return {
        **_tls_settings({"listen_certificate": files[0], "listen_private_key": files[1]}, directory),
        "transport/unicast/max_sessions": _MAX_SESSIONS,
        "low_pass_filter": _size_limits(),
        "access_control": _access_rules({role: [name for name in roles if roles[name] == role] for role in ROLES}),
    }


def client_settings(path: str | os.PathLike[str], name: str) -> dict[str, object]:
    """Return the Zenoh settings of a client: mutual TLS.

    Args:
        path: directory with ``ca.pem`` and the certificate and key of the client.
        name: name of the client.

    Raises:
        InvalidInput: a file is missing, or the name is none of a client.
    """
    directory = Path(path)
    if not _CLIENT_NAME.fullmatch(name):
        raise InvalidInput("name", name, "the name of a client: letters, digits, and . _ - after the first character")
    files = _certificate_files(directory, name)
    return _tls_settings({"connect_certificate": files[0], "connect_private_key": files[1]}, directory)


def _check_authority(path: str | os.PathLike[str]) -> Path:
    """Return a directory with the key of a certificate authority.

    Raises:
        InvalidInput: it has none.
    """
    from graspforce.service.security.certificates import AUTHORITY

    directory = Path(path)
    if not (directory / f"{AUTHORITY}.key").exists():
        raise InvalidInput("directory", str(directory), "one that `graspforce secure init` made, with the authority's key")
    return directory


def _write_configuration(path: Path, settings: Mapping[str, object]) -> None:
    """Write a Zenoh configuration from settings by key."""
    nested: dict[str, Any] = {"scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}}}
    for key, value in settings.items():
        *parents, name = key.split("/")
        place = nested
        for parent in parents:
            place = place.setdefault(parent, {})
        place[name] = value
    write_text(path, json.dumps(nested, indent=2) + "\n")


def _size_limits() -> list[dict[str, object]]:
    """Return Zenoh's limits of the messages that clients send, by key: what monitors may ask, states, and moves."""
    states, plans = [f"{protocol.PREFIX}/streams/**/state"], [f"{protocol.PREFIX}/hands/*/{task}" for task in ("plan", "grasp")]
    limits = (("look", "query", _MONITOR_KEYS), ("states", "put", states), ("plans", "query", plans))
    return [
        {"id": id, "flows": ["ingress"], "messages": [kind], "key_exprs": list(keys), "size_limit": _SIZE_LIMITS[id]}
        for id, kind, keys in limits
    ]


def _tls_settings(own: dict[str, str], directory: Path) -> dict[str, object]:
    """Return the settings of TLS for both sides."""
    authority = str((directory / "ca.pem").resolve())
    values: dict[str, object] = {"root_ca_certificate": authority, "enable_mtls": True, "close_link_on_expiration": True, **own}
    return {f"transport/link/tls/{name}": value for name, value in values.items()}


def _certificate_files(directory: Path, name: str) -> tuple[str, str]:
    """Return the paths of a certificate and its key.

    Raises:
        InvalidInput: one of them, or ``ca.pem``, is missing.
    """
    paths = [directory / file for file in ("ca.pem", f"{name}.pem", f"{name}.key")]
    for path in paths:
        if not path.is_file():
            raise InvalidInput("secure", str(directory), f"a directory with {path.name}: see `graspforce secure`")
    return str(paths[1].resolve()), str(paths[2].resolve())


def _read_roles(directory: Path) -> dict[str, str]:
    """Return the role of each client."""
    try:
        values = json.loads((directory / _ROLES_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InvalidInput("secure", str(directory), f"a directory with {_ROLES_FILE} ({error})") from None
    values = fields.check_record(values, _ROLES_FILE, optional=None)
    return {name: fields.check_choice(role, f"{_ROLES_FILE}: {name}", ROLES) for name, role in values.items()}


def _access_rules(names: dict[str, list[str]]) -> dict[str, object]:
    """Return Zenoh's access control for clients by role. Everything that no rule allows is refused."""
    alive, askers = f"{protocol.PREFIX}/alive/*", f"{protocol.PREFIX}/plans/**/asker"
    common = [
        _rule("answers", "egress", ["reply", "declare_queryable"], [_ALL]),
        _rule("servers", "egress", ["liveliness_token"], [alive]),
        _rule("presence", "ingress", ["liveliness_query", "declare_liveliness_subscriber"], [alive]),
    ]
    look = [
        _rule("look", "ingress", ["query"], _MONITOR_KEYS),
        _rule("watch", "ingress", ["declare_subscriber"], _STREAM_MESSAGES),
        _rule("watched", "egress", ["put"], _STREAM_MESSAGES),
    ]
    ask = [
        _rule("ask", "ingress", ["query"], _CONTROLLER_KEYS),
        _rule("cancel", "egress", ["declare_subscriber"], [f"{protocol.PREFIX}/plans/**/cancel"]),
        _rule("gone", "egress", ["declare_liveliness_subscriber", "liveliness_query"], [askers]),
    ]
    shared = {MONITOR: [*common, *look], CONTROLLER: [*common, *ask]}
    rules, policies = [*common, *look, *ask], []
    for role in ROLES:
        for name in names[role]:
            own = _own_rules(name) if role == CONTROLLER else []
            rules += own
            policies.append({"rules": [each["id"] for each in (*shared[role], *own)], "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for role in ROLES for name in names[role]],
        "policies": policies,
    }


def _own_rules(name: str) -> list[dict[str, object]]:
    """Return the rules of a controller for the streams and plans below its own name."""
    stream, plan = f"{protocol.PREFIX}/streams/{name}/*", f"{protocol.PREFIX}/plans/{name}/*"
    sent, received = [f"{stream}/state", f"{plan}/cancel"], [f"{stream}/command", f"{plan}/progress"]
    return [
        _rule(f"{name}: open", "ingress", ["query"], [stream]),
        _rule(f"{name}: drive", "ingress", ["put"], sent),
        _rule(f"{name}: states", "egress", ["declare_subscriber"], sent),
        _rule(f"{name}: follow", "ingress", ["declare_subscriber"], received),
        _rule(f"{name}: commands", "egress", ["put"], received),
        _rule(f"{name}: ask for plans", "ingress", ["liveliness_token"], [f"{plan}/asker"]),
    ]


def _rule(id: str, flow: str, messages: Sequence[str], keys: Sequence[str]) -> dict[str, object]:
    """Return a rule that allows messages of a flow, "ingress" or "egress", for keys."""
    return {"id": id, "permission": "allow", "flows": [flow], "messages": list(messages), "key_exprs": list(keys)}
