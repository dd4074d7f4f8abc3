"""The status of a server on the wire."""

from __future__ import annotations

import pytest

from graspforce.service import ServerStatus
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import JSON, MSGPACK

CODECS = pytest.mark.parametrize("codec", [JSON, MSGPACK])


def test_status_survives_the_wire():
    latency = {"count": 3, "p50": 0.1, "p99": 0.2, "max": 0.3}
    status = ServerStatus("1.2", "abc", 5.5, ("left", "right"), 2, 4, 1, {"solve": {"ok": 3, "invalid": 1}}, latency)
    for codec in (JSON, MSGPACK):
        assert ServerStatus.from_dict(protocol.decode(protocol.encode(status.to_dict(), codec), codec)) == status
