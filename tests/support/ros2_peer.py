"""A peer in ROS 2: the library zenoh-ros2-sdk at a router, with the types of messages given, because it would download them."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator

import zenoh
import zenoh_ros2_sdk
from zenoh_ros2_sdk.session import ZenohSession

from graspforce.service.ros2 import interfaces
from graspforce.service.zenoh_session import build_configuration, find_addresses
from support.servers import ANY_LOCAL_PORT, wait_until

HOST = "127.0.0.1"


@contextlib.contextmanager
def router(listen: str = ANY_LOCAL_PORT) -> Iterator[str]:
    """Run a router, and yield its endpoint."""
    gossip = {"scouting/gossip/enabled": True}
    settings = {"mode": "router", "listen/endpoints": [listen], "adminspace/enabled": True, **gossip}
    config = build_configuration(None, {}, settings)
    session = zenoh.open(config)
    yield find_addresses(session, config)[0]
    with contextlib.suppress(zenoh.ZError):
        session.close()


class Peer:
    """The library in this process, connected to a router.

    Args:
        address: endpoint of the router.
    """

    def __init__(self, address: str) -> None:
        logging.getLogger("zenoh_ros2_sdk").setLevel(logging.ERROR)
        self.port = int(address.rpartition(":")[2])
        self.session = ZenohSession.get_instance(HOST, self.port)
        self._parts: list[object] = []

    def close(self) -> None:
        """Leave the router."""
        for part in reversed(self._parts):
            part.close()
        self.session.close()

    def publisher(self, topic: str, type_name: str) -> zenoh_ros2_sdk.ROS2Publisher:
        """Return a publisher of a topic."""
        return self._made(zenoh_ros2_sdk.ROS2Publisher, topic, type_name, msg_definition=self._definition(type_name))

    def subscriber(self, topic: str, type_name: str, callback) -> zenoh_ros2_sdk.ROS2Subscriber:
        """Subscribe to a topic."""
        options = {"msg_definition": self._definition(type_name), "callback": callback}
        return self._made(zenoh_ros2_sdk.ROS2Subscriber, topic, type_name, **options)

    def client(self, service: str, type_name: str, request: str, response: str) -> zenoh_ros2_sdk.ROS2ServiceClient:
        """Return a client of a service, once the router has told it of the server: a call before that gets no answer."""
        options = {"request_definition": request, "response_definition": response, "timeout": 20.0}
        client = self._made(zenoh_ros2_sdk.ROS2ServiceClient, service, type_name, **options)
        wait_until(lambda: client.querier.matching_status.matching)
        return client

    def _made(self, kind, name: str, type_name: str, **options):
        """Return a part of the library's node, which `close` will close."""
        hash_ = interfaces.type_hash(type_name)
        part = kind(name, type_name, type_hash=hash_, router_ip=HOST, router_port=self.port, **options)
        self._parts.append(part)
        return part

    @staticmethod
    def _definition(type_name: str) -> str:
        """Return the definition of a message with those of its parts."""
        text, _ = interfaces.make_store().generate_msgdef(type_name, ros_version=2)
        return text


@contextlib.contextmanager
def peer(address: str) -> Iterator[Peer]:
    """Connect the library to a router, and yield it."""
    joined = Peer(address)
    try:
        yield joined
    finally:
        joined.close()
