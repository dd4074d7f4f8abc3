"""Tables of a running server: its state, streams, clients and requests."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.text import Text

from graspforce.cli.tables import NO_VALUE, count_text, make_table
from graspforce.core.printable import escape_controls
from graspforce.service.wire.latency_histogram import LatencyHistogram
from graspforce.service.wire.status_records import ServerStatus

_MEBIBYTE = 2**20


def server_report(status: ServerStatus, previous: ServerStatus | None = None) -> RenderableType:
    """Return the tables of a server.

    Args:
        status: its status.
        previous: an earlier status of the same server, for the rates; without it, rates are those since the start.
    """
    if previous is not None and (previous.server != status.server or previous.uptime >= status.uptime):
        previous = None
    parts: list[RenderableType] = [_heading(status), "", _stream_table(status, previous)]
    if status.clients:
        parts += ["", _client_table(status)]
    return Group(*parts, "", _request_table(status, previous))


def _heading(status: ServerStatus) -> Text:
    """Return name, state and load of the server."""
    state = Text("ready", "bold green") if status.problem is None else Text(escape_controls(status.problem), "bold red")
    load = (
        f"{count_text(status.streams, 'stream')}, {count_text(status.plans, 'plan')}, "
        f"{count_text(status.queue, 'request')} waiting ({status.queue_bytes / _MEBIBYTE:.1f} MiB), "
        f"memory {status.memory / _MEBIBYTE:.0f} MiB, up {status.uptime:.0f} s"
    )
    return Text.assemble((f"Server {escape_controls(status.server)}", "bold"), ": ", state, f"\n{load}")


def _stream_table(status: ServerStatus, previous: ServerStatus | None) -> RenderableType:
    """Return states, rates and latencies of the open streams."""
    if not status.active_streams:
        return Text("No open streams.")
    before = {} if previous is None else {stream.id: stream for stream in previous.active_streams}
    streams = status.active_streams
    elapsed = None if previous is None else status.uptime - previous.uptime  # s
    rates = [
        NO_VALUE if elapsed is None or s.id not in before else f"{(len(s.latency) - len(before[s.id].latency)) / elapsed:.0f}"
        for s in streams
    ]
    columns = [
        ("stream", [escape_controls(s.id) for s in streams]),
        ("hand", [escape_controls(s.hand) for s in streams]),
        ("client", [escape_controls(s.client) for s in streams]),
        ("states/s", rates),
        ("states", [str(sum(s.outcomes.values())) for s in streams]),
        ("refused", [str(sum(count for outcome, count in s.outcomes.items() if outcome != "ok")) for s in streams]),
        ("skipped", [str(s.skipped) for s in streams]),
        ("late", [str(s.late) for s in streams]),
        ("idle (s)", [f"{s.idle:.2f}" for s in streams]),
        *_latency_columns([s.latency for s in streams]),
    ]
    return make_table(columns, left=3)


def _client_table(status: ServerStatus) -> RenderableType:
    """Return what each client uses."""
    columns = [("client", [escape_controls(client) for client in status.clients])]
    columns += [(name, [str(use.get(name, 0)) for use in status.clients.values()]) for name in ("streams", "plans", "waiting")]
    return make_table(columns)


def _request_table(status: ServerStatus, previous: ServerStatus | None) -> RenderableType:
    """Return counts, rates and latencies of requests by key."""
    if not status.counts:
        return Text("No requests yet.")
    elapsed = status.uptime if previous is None else status.uptime - previous.uptime  # s
    totals = {key: sum(outcomes.values()) for key, outcomes in status.counts.items()}
    old = {} if previous is None else {key: sum(outcomes.values()) for key, outcomes in previous.counts.items()}
    columns = [
        ("key", [escape_controls(key) for key in totals]),
        ("requests", [str(total) for total in totals.values()]),
        ("requests/s", [f"{(total - old.get(key, 0)) / max(elapsed, 1e-3):.1f}" for key, total in totals.items()]),
        ("errors", [str(total - status.counts[key].get("ok", 0)) for key, total in totals.items()]),
        *_latency_columns([status.latencies.get(key) for key in totals]),
    ]
    return make_table(columns)


def _latency_columns(histograms: list[LatencyHistogram | None]) -> list[tuple[str, list[str]]]:
    """Return the columns of median, 99 % and largest latency."""

    def milliseconds(seconds: float | None) -> str:
        return NO_VALUE if seconds is None else f"{1e3 * seconds:.3g}"

    return [
        ("median ≤ (ms)", [milliseconds(None if each is None else each.quantile(0.5)) for each in histograms]),
        ("99 % ≤ (ms)", [milliseconds(None if each is None else each.quantile(0.99)) for each in histograms]),
        ("largest (ms)", [milliseconds(each.largest if each is not None and len(each) else None) for each in histograms]),
    ]
