"""Metrics, health, readiness, and messages to the service manager."""

from __future__ import annotations

import socket
import threading
import urllib.error
import urllib.request
from types import SimpleNamespace

import pytest
from prometheus_client.parser import text_string_to_metric_families
from support.control_requests import GRASP, desired, state
from support.servers import ANY_LOCAL_PORT, TIMEOUT, wait_until
from support.service_requests import pinch

from graspforce.core.errors import ErrorReply, InvalidInput, ServiceError
from graspforce.service import Client, Server, ServerLimits
from graspforce.service.server import service_manager
from graspforce.service.server.monitoring import MonitoringServer
from graspforce.service.server.service_manager import ServiceManager
from graspforce.service.wire.latency_histogram import BOUNDS, LatencyHistogram


@pytest.fixture
def monitoring(server):
    opened = MonitoringServer("127.0.0.1:0", server.status)
    yield opened
    opened.close()


def fetch(monitoring, path):
    """Return code and text of an HTTP request."""
    try:
        with urllib.request.urlopen(f"http://{monitoring.address}{path}", timeout=TIMEOUT) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def samples(text):
    """Return the value of each sample by name and labels."""
    return {
        (sample.name, *sorted(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_metrics_count_requests_refusals_and_states(client, monitoring):
    assert client.solve(pinch()).found
    with pytest.raises(ErrorReply):
        client.solve({})
    with client.open_stream(GRASP, validity=TIMEOUT) as stream:
        for k in range(5):
            stream.step(state(k), desired(), wait=TIMEOUT)
        code, text = fetch(monitoring, "/metrics")
        own = (("hand", "four_finger"), ("stream", stream.id))
        found = samples(text)
        assert code == 200
        assert found["graspforce_stream_states_total", own[0], ("outcome", "ok"), own[1]] == 5
        assert found["graspforce_stream_seconds_bucket", own[0], ("le", "+Inf"), own[1]] == 5
        assert found[("graspforce_stream_skipped_states_total", *own)] == 0
        assert found["graspforce_streams",] == 1
    assert found["graspforce_requests_total", ("key", "solve"), ("outcome", "ok")] >= 1
    assert found["graspforce_requests_total", ("key", "solve"), ("outcome", "invalid")] >= 1
    assert found["graspforce_request_seconds_count", ("key", "solve")] >= 2
    assert found["graspforce_refusals_total", ("reason", "overloaded")] == 0
    assert found["graspforce_resident_memory_bytes",] > 2**20
    assert found["graspforce_ready",] == 1


def test_status_lists_streams_and_clients(client):
    with client.open_stream(GRASP, validity=TIMEOUT) as stream:
        stream.step(state(0), desired(), wait=TIMEOUT)
        status = client.status()
        (row,) = status.active_streams
        assert (row.id, row.hand, dict(row.outcomes), row.late) == (stream.id, "four_finger", {"ok": 1}, 0)
        assert len(row.latency) == 1
        assert row.latency.quantile(0.5) == row.latency.largest
        assert status.clients[row.client] == {"waiting": 0, "streams": 1, "plans": 0}
    assert client.status().active_streams == ()


def test_readiness_ends_when_a_thread_does_not_finish_and_when_the_server_closes(monkeypatch):
    release = threading.Event()
    with Server(listen=ANY_LOCAL_PORT, limits=ServerLimits(stall_time=0.2)) as server:
        monitoring = MonitoringServer(":0", server.status)
        assert fetch(monitoring, "/readyz") == fetch(monitoring, "/healthz") == (200, "ok\n")
        assert fetch(monitoring, "/other")[0] == 404
        monkeypatch.setattr(server._handler, "_tasks", {"solve": lambda *_: release.wait(TIMEOUT) and {}})
        with Client(server.addresses[0], timeout=TIMEOUT) as client:
            thread = threading.Thread(target=client.query, args=("solve", pinch()), daemon=True)
            thread.start()
            wait_until(lambda: fetch(monitoring, "/healthz")[0] == 503)
            assert "in progress" in fetch(monitoring, "/readyz")[1]
            release.set()
            wait_until(lambda: fetch(monitoring, "/healthz")[0] == 200)
            thread.join(TIMEOUT)  # a query that goes on while its client closes ends with an error
            assert not thread.is_alive()
    assert fetch(monitoring, "/readyz")[0] == 503
    monitoring.close()


def test_invalid_and_used_addresses_of_metrics_are_named(server, monitoring):
    for wrong in ("localhost", "127.0.0.1:99999", "a:b"):
        with pytest.raises(InvalidInput, match="HOST:PORT"):
            MonitoringServer(wrong, server.status)
    with pytest.raises(ServiceError, match="in use"):
        MonitoringServer(monitoring.address, server.status)


def test_service_manager_hears_ready_alive_and_stopping(monkeypatch, tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.settimeout(TIMEOUT)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "100000")
        clock = [100.0]  # s
        monkeypatch.setattr(service_manager, "time", SimpleNamespace(monotonic=lambda: clock[0]))
        manager = ServiceManager()
        manager.ready("serving")
        assert listener.recv(256) == b"READY=1\nSTATUS=serving"
        assert manager.is_alive_due()
        manager.alive()
        assert listener.recv(256) == b"WATCHDOG=1"
        assert not manager.is_alive_due()
        clock[0] += 0.029  # s; 0.3 of the watchdog's time is 0.03 s
        assert not manager.is_alive_due()
        clock[0] += 0.002
        assert manager.is_alive_due()
        manager.stopping()
        assert listener.recv(256) == b"STOPPING=1"


def test_service_manager_without_a_socket_is_silent(monkeypatch):
    for name in ("NOTIFY_SOCKET", "WATCHDOG_USEC"):
        monkeypatch.delenv(name, raising=False)
    manager = ServiceManager()
    manager.ready("serving")
    assert not manager.is_alive_due()


def test_quantiles_of_a_histogram_bound_those_of_its_values():
    histogram = LatencyHistogram()
    assert histogram.quantile(0.5) is None
    values = [1e-5 * 1.3**k for k in range(60)]  # s, beyond the last bucket, too
    for value in values:
        histogram.observe(value)
    for fraction in (0.1, 0.5, 0.9, 1.0):
        exact = values[max(int(fraction * len(values)) - 1, 0)]
        bound = next((each for each in BOUNDS if each >= exact), max(values))
        assert histogram.quantile(fraction) == bound
    assert LatencyHistogram.from_dict(histogram.to_dict()) == histogram
