"""A server of one stream in the process of the test, and the connection to it."""

from __future__ import annotations

from collections import deque

from graspforce.core.errors import NoServer
from graspforce.service.server.stream_registry import StreamRegistry
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import MSGPACK
from support.control_requests import HAND


class LocalServer:
    """A server in this process, and the connection to it. It can be unreachable (`away`) or slow (`silent`)."""

    def __init__(self, hand=HAND):
        self.streams = StreamRegistry({hand.name: hand}, capacity=4, idle_timeout=10.0)
        self.away = self.silent = False
        self.asked, self.closed = [], False
        self.payloads = []
        self.box = deque(maxlen=1)

    def query(self, record):
        self.asked.append(record)
        if self.away:
            raise NoServer("no server is alive")
        return self.streams.answer("a", protocol.decode(protocol.encode(record, MSGPACK), MSGPACK))

    def connect(self):
        return self

    def take_in(self, payload, encoding):
        self.box.append((payload, encoding))

    def receive(self):
        return self.box.popleft() if self.box else None

    def send(self, payload):
        self.payloads.append(payload)
        if not self.away and not self.silent and len(self.streams):
            self.reply(payload)

    def reply(self, payload):
        reply = self.streams["a"].command(payload, MSGPACK)
        self.take_in(reply.payload, reply.encoding)

    def close(self):
        self.closed = True
