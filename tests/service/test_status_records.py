"""The status of a server on the wire."""

from __future__ import annotations

import pytest

from graspforce.core.errors import InvalidInput
from graspforce.service import ServerStatus
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import JSON, MSGPACK


def test_status_survives_the_wire():
    latency = {"count": 3, "p50": 0.1, "p99": 0.2, "max": 0.3}
    status = ServerStatus("1.2", "abc", 5.5, ("left", "right"), 2, 4, 1, {"solve": {"ok": 3, "invalid": 1}}, latency)
    for codec in (JSON, MSGPACK):
        assert ServerStatus.from_dict(protocol.decode(protocol.encode(status.to_dict(), codec), codec)) == status


def test_status_prints_as_a_table():
    latency = {"count": 3, "p50": 2e-4, "p99": 3e-3, "max": 4e-3}
    counts = {"solve": {"invalid": 1, "ok": 20}, "status": {"ok": 2}}
    lines = str(ServerStatus("1.2", "abc", 5.5, ("left", "right"), 2, 4, 1, counts, latency)).splitlines()
    assert lines[0].split() == ["server", "abc,", "graspforce", "1.2,", "up", "6", "s"]
    assert "0.20 ms median, 3.00 ms p99, 4.00 ms largest of 3 requests" in lines[4]
    assert [line.split() for line in lines[6:]] == [["requests", "ok", "invalid"], ["solve", "20", "1"], ["status", "2", "0"]]
    assert len({len(line) for line in lines[6:]}) == 1  # columns are aligned
    none = {"count": 0, "p50": None, "p99": None, "max": None}
    assert "no requests yet" in str(ServerStatus("1.2", "abc", 0.0, (), 0, 0, 0, {}, none))


def test_status_of_other_versions_can_be_read():
    """A newer server has further fields, an older one lacks the later ones."""
    latency = {"count": 0, "p50": None, "p99": None, "max": None}
    record = ServerStatus("1.2", "abc", 5.5, ("left",), 0, 0, 0, {}, latency, ("1", "2"), ("flight",), 7).to_dict()
    assert ServerStatus.from_dict({**record, "moons": 2}).capabilities == ("flight",)
    old = {name: value for name, value in record.items() if name not in ("versions", "capabilities", "queue_bytes")}
    assert ServerStatus.from_dict(old).versions == ("1",)
    for name in ("hands", "latency"):
        with pytest.raises(InvalidInput, match=name):
            ServerStatus.from_dict({key: value for key, value in record.items() if key != name})


def test_server_lists_versions_and_capabilities(client):
    status = client.status()
    assert status.versions == ("1",)
    assert "authenticated_streams" in status.capabilities
    assert status.queue_bytes == 0
    assert status.addresses
    assert all(address.startswith("tcp/127.0.0.1:") for address in status.addresses)
    assert f"at       {status.addresses[0]}" in str(status)
