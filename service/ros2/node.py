"""A node of ROS 2 in a Zenoh session: publishers, subscriptions and services that nodes of rmw_zenoh find and use."""

from __future__ import annotations

import itertools
import logging
import os
import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh
from zenoh.handlers import RingChannel

from graspforce.core.errors import InvalidInput
from graspforce.service.realtime_scheduling import schedule_thread
from graspforce.service.ros2 import interfaces
from graspforce.service.ros2.key_expressions import (
    DEFAULT_QOS,
    PUBLISHER,
    SERVICE,
    SUBSCRIPTION,
    Attachment,
    Entity,
    NodeName,
    data_key,
    entity_token,
    node_token,
    queue_depth,
)
from graspforce.service.zenoh_session import describe_zenoh_error

log = logging.getLogger("graspforce.ros2")

_CDR = "application/cdr"
_GID_BYTES = 16
_FIRST_ENTITY = 1  # the node itself has the number 0
_MAX_REQUESTS = 8  # of one service, that are answered at the same time
_BUSY = b"too many requests of this service are being answered"
_CLOSE_TIMEOUT = 1.0  # s


class Publisher:
    """A publisher of one topic. Thread-safe.

    Args:
        session: an open session.
        key: key of the topic.
        type_name: name of the type of its messages.
    """

    def __init__(self, session: zenoh.Session, key: str, type_name: str) -> None:
        self._key, self._type, self._gid = key, type_name, os.urandom(_GID_BYTES)
        self._lock, self._numbers, self._is_closed = threading.Lock(), itertools.count(1), False
        drop = zenoh.CongestionControl.DROP  # a slow subscriber must not stop the control loop
        self._publisher = session.declare_publisher(key, encoding=_CDR, congestion_control=drop, express=True)

    def publish(self, message: Any) -> None:
        """Send a message, unless the publisher is closed. A failure is only logged.

        Args:
            message: a message of the topic's type.
        """
        payload = interfaces.encode(self._type, message)
        with self._lock:
            if self._is_closed:
                return
            attachment = Attachment(next(self._numbers), time.time_ns(), self._gid).encode()
            try:
                self._publisher.put(payload, attachment=attachment)
            except zenoh.ZError as error:
                log.warning("cannot publish %s: %s", self._key, describe_zenoh_error(error))

    def close(self) -> None:
        """Stop publishing."""
        with self._lock:
            self._is_closed = True
            self._publisher.undeclare()


class Subscription:
    """A subscription to one topic: its thread calls a function with each message.

    Some messages wait while the function runs; of more, the oldest are dropped. Messages that are not of the type are logged
    and ignored.

    Attributes:
        refused: number of messages that could not be read.
        lost: number of messages that did not arrive or were dropped, from the gaps in the numbers of their publisher.

    Args:
        session: an open session.
        key: key of the topic.
        type_name: name of the type of its messages.
        callback: called with each message.
        depth: number of messages that may wait.
        priority: real-time priority of the thread of the topic; None for that of the thread which subscribes.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        type_name: str,
        callback: Callable[[Any], None],
        depth: int = 10,
        *,
        priority: int | None = None,
    ) -> None:
        self._key, self._type, self._callback = key, type_name, callback
        self.refused = self.lost = 0
        self._last: Attachment | None = None
        self._subscriber = session.declare_subscriber(key, RingChannel(depth))
        self._receive = self._subscriber.handler.recv  # the subscriber cannot be used while `close` undeclares it
        self._thread = threading.Thread(target=self._run, args=(priority,), name=f"ros2-{key.split('/')[-3]}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Take no more messages, and wait for the one in progress."""
        self._subscriber.undeclare()
        self._thread.join(_CLOSE_TIMEOUT)

    def _run(self, priority: int | None) -> None:
        """Call the function with each message until the subscription is closed."""
        schedule_thread(priority)
        while True:
            try:
                sample = self._receive()
            except zenoh.ZError:  # closed
                return
            try:
                self._count(b"" if sample.attachment is None else sample.attachment.to_bytes())
                self._callback(interfaces.decode(self._type, sample.payload.to_bytes()))
            except InvalidInput as error:
                self.refused += 1
                log.warning("a message of %s is refused: %s", self._key, error)
            except Exception:
                self.refused += 1
                log.exception("a message of %s failed", self._key)

    def _count(self, attachment: bytes) -> None:
        """Count the messages between this one and the last one of the same publisher.

        Raises:
            InvalidInput: the attachment is not that of a message of ROS 2.
        """
        given, last = Attachment.decode(attachment), self._last
        if last is not None and given.gid == last.gid and given.sequence > last.sequence:
            self.lost += given.sequence - last.sequence - 1
        self._last = given


class ServiceServer:
    """A service: each request is answered in a thread of its own.

    Args:
        session: an open session.
        key: key of the service.
        type_name: name of its type.
        answer: function that returns the response to a request.
    """

    def __init__(self, session: zenoh.Session, key: str, type_name: str, answer: Callable[[Any], Any]) -> None:
        self._key, self._type, self._answer = key, type_name, answer
        self._gid, self._free = os.urandom(_GID_BYTES), threading.BoundedSemaphore(_MAX_REQUESTS)
        callback = zenoh.handlers.Callback(self._receive, indirect=False)
        self._queryable = session.declare_queryable(key, callback, complete=True)

    def close(self) -> None:
        """Take no more requests."""
        self._queryable.undeclare()

    def _receive(self, query: zenoh.Query) -> None:
        """Begin to answer a request, on Zenoh's receiving thread."""
        is_free = self._free.acquire(blocking=False)
        target = self._reply if is_free else self._refuse
        threading.Thread(target=target, args=(query,), name=f"ros2-{self._type}", daemon=True).start()

    def _refuse(self, query: zenoh.Query) -> None:
        """Refuse a request."""
        with query:
            query.reply_err(_BUSY)

    def _reply(self, query: zenoh.Query) -> None:
        """Answer a request: with an error if it is none, or if the function fails."""
        try:
            with query:
                try:
                    payload, attachment = query.payload, query.attachment
                    asked = Attachment.decode(b"" if attachment is None else attachment.to_bytes())
                    request = interfaces.decode(f"{self._type}_Request", b"" if payload is None else payload.to_bytes())
                    response = interfaces.encode(f"{self._type}_Response", self._answer(request))
                except InvalidInput as error:
                    query.reply_err(str(error).encode())
                    return
                except Exception:
                    log.exception("a request of %s failed", self._key)
                    query.reply_err(b"internal error; the log of the server has the details")
                    return
                back = Attachment(asked.sequence, time.time_ns(), asked.gid).encode()
                query.reply(self._key, response, encoding=_CDR, attachment=back)
        except zenoh.ZError as error:
            log.warning("cannot answer a request of %s: %s", self._key, describe_zenoh_error(error))
        finally:
            self._free.release()


class Node:
    """A node with its publishers, subscriptions and services. Use it as a context manager, or call `close`.

    Args:
        session: an open session; the node does not close it.
        name: name of the node.
    """

    def __init__(self, session: zenoh.Session, name: NodeName) -> None:
        self._session, self.name, self._numbers = session, name, itertools.count(_FIRST_ENTITY)
        self._zid = str(session.zid())
        self._parts: list[Any] = [session.liveliness().declare_token(node_token(name, self._zid))]

    def __enter__(self) -> Node:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def publish(self, topic: str, type_name: str, qos: str = DEFAULT_QOS) -> Publisher:
        """Return a publisher of a topic.

        Args:
            topic: its name; ``~/`` stands for the name of the node.
            type_name: name of the type of its messages, such as ``sensor_msgs/msg/JointState``.
            qos: quality of service.

        Raises:
            InvalidInput: the name is not allowed.
        """
        key = self._declare(PUBLISHER, topic, type_name, qos)
        made = Publisher(self._session, key, type_name)
        self._parts.append(made)
        return made

    def subscribe(
        self,
        topic: str,
        type_name: str,
        callback: Callable[[Any], None],
        qos: str = DEFAULT_QOS,
        *,
        priority: int | None = None,
    ) -> Subscription:
        """Subscribe to a topic.

        Args:
            topic: as in `publish`.
            type_name: as in `publish`.
            callback: called with each message, in a thread of this topic.
            qos: quality of service.
            priority: real-time priority of the thread; None for that of this one.

        Raises:
            InvalidInput: the name is not allowed.
        """
        key = self._declare(SUBSCRIPTION, topic, type_name, qos)
        made = Subscription(self._session, key, type_name, callback, queue_depth(qos), priority=priority)
        self._parts.append(made)
        return made

    def serve(self, service: str, type_name: str, answer: Callable[[Any], Any]) -> ServiceServer:
        """Serve a service.

        Args:
            service: its name; ``~/`` stands for the name of the node.
            type_name: name of its type, such as ``std_srvs/srv/Trigger``.
            answer: function that returns the response to a request; several threads may call it.

        Raises:
            InvalidInput: the name is not allowed.
        """
        key = self._declare(SERVICE, service, type_name, DEFAULT_QOS)
        made = ServiceServer(self._session, key, type_name, answer)
        self._parts.append(made)
        return made

    def close(self) -> None:
        """Remove the node with all its parts. A second call does nothing."""
        while self._parts:
            part = self._parts.pop()
            try:
                part.close() if hasattr(part, "close") else part.undeclare()
            except zenoh.ZError as error:
                log.warning("cannot remove a part of the node %s: %s", self.name.name, describe_zenoh_error(error))

    def _declare(self, kind: str, name: str, type_name: str, qos: str) -> str:
        """Declare the liveliness token of a publisher, a subscription or a service, and return its key."""
        full = self.name.resolve(name)
        entity = Entity(kind, next(self._numbers), full, type_name, qos)
        self._parts.append(self._session.liveliness().declare_token(entity_token(self.name, self._zid, entity)))
        return data_key(self.name.domain, full, type_name)
