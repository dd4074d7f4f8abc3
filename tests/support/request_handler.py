"""A request handler without a network, and requests to it, for the tests of the service."""

from __future__ import annotations

import json
from typing import Any

import pytest

from graspforce.hand.hand import Hand
from graspforce.service import RequestHandler
from graspforce.service.server.server_load import ServerLoad
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import JSON, MSGPACK

CODECS = pytest.mark.parametrize("codec", [JSON, MSGPACK])
HAND = Hand.load("four_finger")
HANDLER = RequestHandler([HAND], server="here", load=lambda: ServerLoad(waiting=3))
DISTRIBUTE = "hands/four_finger/distribute"


def foreign_payload(record: Any, codec: str) -> bytes:
    """Encode a record as other programs do: Python's JSON writes NaN and integers of any size."""
    return json.dumps(record).encode() if codec == JSON else protocol.encode(record, codec)


def ask(
    key: str, record: Any, codec: str = MSGPACK, *, handler: RequestHandler = HANDLER, received: float | None = None
) -> tuple[bool, Any]:
    """Return (ok, record) of the reply to a request, and check that it has the codec of the request."""
    payload = record if isinstance(record, bytes) else foreign_payload(record, codec)
    reply = handler.answer(key, payload, codec, received)
    assert reply.encoding == codec
    return reply.ok, protocol.decode(reply.payload, codec)


def error_code(key: str, record: Any, **options: Any) -> str:
    """Return the error code of the reply to a request that fails."""
    ok, error = ask(key, record, **options)
    assert not ok
    assert set(error) <= {"error", "message", "field", "sequence"}
    return str(error["error"])
