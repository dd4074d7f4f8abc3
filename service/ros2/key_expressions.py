"""Key expressions, liveliness tokens and attachments of rmw_zenoh, as its design document states them.

The key of a topic or a service is ``<domain>/<name>/<type>/<type hash>``. Every node, publisher, subscription and service has a
liveliness token, by which other nodes find it. Names in tokens have ``%`` in place of ``/``.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import NamedTuple

from graspforce.core import fields
from graspforce.core.errors import InvalidInput
from graspforce.service.ros2.interfaces import dds_type, type_hash

LIVELINESS = "@ros2_lv"
PUBLISHER, SUBSCRIPTION, SERVICE = "MP", "MS", "SS"
"""Kinds of endpoints in liveliness tokens."""
DEFAULT_QOS = "::,10:,:,:,,"
"""Reliable, volatile, the last 10 messages: the other policies have their defaults, which are written as empty fields."""
SENSOR_QOS = "2::,10:,:,:,,"
"""The same as best effort."""
STATE_QOS = "2::,50:,:,:,,"
"""Best effort, the last 50 messages: joint states of 0.1 s at 500 Hz, so that a pause of the process loses none."""
LATCHED_QOS = ":1:,1:,:,:,,"
"""Reliable and transient local: late subscribers get the last message."""

_GID_BYTES = 16
_ATTACHMENT = struct.Struct(f"<qqB{_GID_BYTES}s")
_LARGEST_DOMAIN = 232
_NODE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_FULL_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


def queue_depth(qos: str) -> int:
    """Return the number of messages that a quality of service keeps.

    Args:
        qos: quality of service, as in a token.
    """
    return int(qos.split(",")[1].partition(":")[0])


@dataclass(frozen=True, slots=True)
class NodeName:
    """Name of a node, in its domain.

    Args:
        name: name without namespace: letters, digits and underscores.
        namespace: namespace, such as ``/left``; ``/`` for none.
        domain: `ROS_DOMAIN_ID`, 0 to 232.

    Raises:
        InvalidInput: a value is not allowed.
    """

    name: str
    namespace: str = "/"
    domain: int = 0

    def __post_init__(self) -> None:
        if not _NODE_NAME.fullmatch(fields.check_text(self.name, "name")):
            raise InvalidInput("name", self.name, "letters, digits and underscores; the first is no digit")
        if self.namespace != "/" and not _FULL_NAME.fullmatch(fields.check_text(self.namespace, "namespace")):
            raise InvalidInput("namespace", self.namespace, "/, or names of letters, digits and underscores, each after a /")
        fields.check_integer(self.domain, "domain", minimum=0, maximum=_LARGEST_DOMAIN)

    def resolve(self, name: str) -> str:
        """Return the full name of a topic or a service.

        Args:
            name: ``~/x`` below the node, ``/x``, or ``x`` in the namespace.

        Raises:
            InvalidInput: the full name has a character that is not allowed.
        """
        space = "" if self.namespace == "/" else self.namespace
        if name.startswith("~/"):
            full = f"{space}/{self.name}/{name[2:]}"
        else:
            full = name if name.startswith("/") else f"{space}/{name}"
        if not _FULL_NAME.fullmatch(full):
            raise InvalidInput("name", name, "names of letters, digits and underscores, separated by /")
        return full


class Entity(NamedTuple):
    """A publisher, a subscription or a service.

    Attributes:
        kind: `PUBLISHER`, `SUBSCRIPTION` or `SERVICE`.
        number: its number within the session; that of the node is 0.
        name: full name of the topic or service.
        type_name: name of its type, such as ``sensor_msgs/msg/JointState``.
        qos: its quality of service.
    """

    kind: str
    number: int
    name: str
    type_name: str
    qos: str = DEFAULT_QOS


def data_key(domain: int, name: str, type_name: str) -> str:
    """Return the key of a topic or a service.

    Args:
        domain: `ROS_DOMAIN_ID`.
        name: its full name.
        type_name: name of its type.
    """
    return f"{domain}/{name.strip('/')}/{dds_type(type_name)}/{type_hash(type_name)}"


def node_token(node: NodeName, session: str, number: int = 0) -> str:
    """Return the liveliness token of a node.

    Args:
        node: name of the node.
        session: id of its Zenoh session, in hexadecimal.
        number: number of the node in the session.
    """
    return f"{_session_part(node, session, number, number, 'NN')}/{node.name}"


def entity_token(node: NodeName, session: str, entity: Entity, number: int = 0) -> str:
    """Return the liveliness token of a publisher, a subscription or a service.

    Args:
        node: name of its node.
        session: id of the Zenoh session, in hexadecimal.
        entity: the publisher, subscription or service.
        number: number of the node in the session.
    """
    start = f"{_session_part(node, session, number, entity.number, entity.kind)}/{node.name}"
    return f"{start}/{_mangle(entity.name)}/{dds_type(entity.type_name)}/{type_hash(entity.type_name)}/{entity.qos}"


class Attachment(NamedTuple):
    """Attachment of a message, a request or a response; of a response, with sequence and gid of its request.

    Attributes:
        sequence: number of the message or request, from 1.
        time: when it was sent, ns since 1970.
        gid: 16 bytes that name the publisher or client.
    """

    sequence: int
    time: int
    gid: bytes

    def encode(self) -> bytes:
        """Return the bytes."""
        return _ATTACHMENT.pack(self.sequence, self.time, _GID_BYTES, self.gid)

    @classmethod
    def decode(cls, payload: bytes) -> Attachment:
        """Return the attachment of bytes.

        Args:
            payload: the bytes.

        Raises:
            InvalidInput: not such an attachment.
        """
        if len(payload) != _ATTACHMENT.size or payload[_ATTACHMENT.size - _GID_BYTES - 1] != _GID_BYTES:
            raise InvalidInput("attachment", f"{len(payload)} bytes", f"{_ATTACHMENT.size} bytes with a gid of {_GID_BYTES}")
        sequence, time, _, gid = _ATTACHMENT.unpack(payload)
        return cls(sequence, time, gid)


def _session_part(node: NodeName, session: str, node_number: int, number: int, kind: str) -> str:
    """Return a token's part before the name of the node: its enclave is the default one."""
    return f"{LIVELINESS}/{node.domain}/{session}/{node_number}/{number}/{kind}/%/{_mangle(node.namespace)}"


def _mangle(name: str) -> str:
    """Return a name for a token."""
    return name.replace("/", "%")
