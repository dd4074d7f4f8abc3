"""Metrics for Prometheus, health and readiness of a server over HTTP.

| path        | answer                                                                                        |
|-------------|-----------------------------------------------------------------------------------------------|
| ``/metrics``| metrics in the text format of Prometheus                                                      |
| ``/healthz``| 200 while the server runs and each thread finishes its requests, else 503 with the reason     |
| ``/readyz`` | 200 while the server takes work: the same, and 503 from the moment when it closes             |

The library `prometheus-client` writes the metrics (extra ``metrics``).
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from prometheus_client import CollectorRegistry, make_wsgi_app
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric

from graspforce.core.errors import InvalidInput, ServiceError
from graspforce.service.wire.latency_histogram import BOUNDS, LatencyHistogram
from graspforce.service.wire.protocol import REFUSAL_CODES
from graspforce.service.wire.status_records import ServerStatus

_REQUEST_TIMEOUT = 5.0  # s, for the request of an HTTP client
_LARGEST_PORT = 65535


class StatusCollector:
    """The metrics of a server, for a registry of Prometheus.

    Args:
        read_status: function that returns the status of the server.
    """

    def __init__(self, read_status: Callable[[], ServerStatus]) -> None:
        self._read_status = read_status

    def collect(self) -> Iterator[Metric]:
        """Return the present metrics."""
        status = self._read_status()
        build = GaugeMetricFamily("graspforce_info", "Version of graspforce.", labels=["version", "server"])
        build.add_metric([status.version, status.server], 1.0)
        yield build
        gauges = [
            ("ready", "1 if the server takes work.", status.problem is None),
            ("uptime_seconds", "Time since the server started.", status.uptime),
            ("resident_memory_bytes", "Resident memory of the server's process.", status.memory),
            ("queue_requests", "Requests that wait for a solver thread.", status.queue),
            ("queue_bytes", "Bytes of the waiting requests.", status.queue_bytes),
            ("streams", "Open control streams.", status.streams),
            ("plans", "Active plans.", status.plans),
        ]
        for name, text, value in gauges:
            yield GaugeMetricFamily(f"graspforce_{name}", text, value=float(value))
        yield from _request_metrics(status)
        yield from _stream_metrics(status)


def _request_metrics(status: ServerStatus) -> Iterator[Metric]:
    """Return counts and latencies of requests, by key."""
    outcomes = CounterMetricFamily("graspforce_requests", "Requests and states by key and outcome.", labels=["key", "outcome"])
    refusals = CounterMetricFamily("graspforce_refusals", "Refused requests and states by reason.", labels=["reason"])
    refused = dict.fromkeys(REFUSAL_CODES, 0)
    for key, counts in status.counts.items():
        for outcome, count in counts.items():
            outcomes.add_metric([key, outcome], count)
            if outcome in refused:
                refused[outcome] += count
    for reason, count in refused.items():
        refusals.add_metric([reason], count)
    latency = HistogramMetricFamily("graspforce_request_seconds", "Time from receipt to answer, by key.", labels=["key"])
    for key, histogram in status.latencies.items():
        latency.add_metric([key], *_buckets(histogram))
    yield from (outcomes, refusals, latency)


def _stream_metrics(status: ServerStatus) -> Iterator[Metric]:
    """Return counts and latencies of the open streams."""
    labels = ["stream", "hand"]
    latency = HistogramMetricFamily("graspforce_stream_seconds", "Time from receipt of a state to its command.", labels=labels)
    states = CounterMetricFamily("graspforce_stream_states", "States by outcome.", labels=[*labels, "outcome"])
    skipped = CounterMetricFamily("graspforce_stream_skipped_states", "States that newer ones replaced.", labels=labels)
    late = CounterMetricFamily("graspforce_stream_late_commands", "Commands later than their validity.", labels=labels)
    largest = GaugeMetricFamily("graspforce_stream_largest_seconds", "Largest time from state to command.", labels=labels)
    idle = GaugeMetricFamily("graspforce_stream_idle_seconds", "Time since the last valid state.", labels=labels)
    for stream in status.active_streams:
        own = [stream.id, stream.hand]
        latency.add_metric(own, *_buckets(stream.latency))
        for outcome, count in stream.outcomes.items():
            states.add_metric([*own, outcome], count)
        skipped.add_metric(own, stream.skipped)
        late.add_metric(own, stream.late)
        largest.add_metric(own, stream.latency.largest)
        idle.add_metric(own, stream.idle)
    yield from (latency, states, skipped, late, largest, idle)


def _buckets(histogram: LatencyHistogram) -> tuple[list[tuple[str, float]], float]:
    """Return the cumulative buckets of a histogram, and the sum of its values."""
    cumulative, buckets = 0, []
    for bound, count in zip((*map(str, BOUNDS), "+Inf"), histogram.counts, strict=True):
        cumulative += count
        buckets.append((bound, float(cumulative)))
    return buckets, histogram.total


class MonitoringServer:
    """The HTTP server of metrics, health and readiness, on threads of its own.

    Attributes:
        address: host and port at which it listens, as text.

    Args:
        address: ``HOST:PORT``, or a port of this machine only; port 0 for a free one.
        read_status: function that returns the status of the server.

    Raises:
        InvalidInput: the address cannot be read.
        ServiceError: it is in use.
    """

    def __init__(self, address: str, read_status: Callable[[], ServerStatus]) -> None:
        host, _, port = address.rpartition(":")
        if not port.isdecimal() or int(port) > _LARGEST_PORT:
            raise InvalidInput("metrics", address, "HOST:PORT, or a port of this machine")
        registry = CollectorRegistry()
        registry.register(StatusCollector(read_status))
        metrics: Any = make_wsgi_app(registry)

        def answer(environment: Any, start_response: Any) -> Iterable[bytes]:
            path = environment["PATH_INFO"]
            if path == "/metrics":
                shown: Iterable[bytes] = metrics(environment, start_response)
                return shown
            code, text = "404 Not Found", "paths: /metrics, /healthz, /readyz"
            if path in ("/healthz", "/readyz"):
                problem = read_status().problem
                code, text = ("200 OK", "ok") if problem is None else ("503 Service Unavailable", problem)
            start_response(code, [("Content-Type", "text/plain; charset=utf-8")])
            return [f"{text}\n".encode()]

        try:
            self._server = make_server(host.strip("[]") or "127.0.0.1", int(port), answer, _Server, _Handler)
        except OSError as error:
            raise ServiceError(f"cannot serve metrics on {address}: {error.strerror}") from None
        self.address = f"{self._server.server_address[0]!s}:{self._server.server_address[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever, name="metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop to listen."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingMixIn, WSGIServer):
    """A server with a thread for each request. Its end does not wait for them."""

    daemon_threads = True
    block_on_close = False


class _Handler(WSGIRequestHandler):
    """A handler with a time limit and without a log."""

    timeout = _REQUEST_TIMEOUT

    def log_message(self, format: str, *values: object) -> None:
        """Write nothing."""
