"""The command ``graspforce watch``: compare streams, recorded or running, with the model, and show drift."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.text import Text

from graspforce.cli.interruption import Interruption
from graspforce.cli.json_output import put_result
from graspforce.cli.running_streams import choose_stream, is_stream_open, load_named
from graspforce.cli.tables import make_table
from graspforce.core.printable import escape_controls
from graspforce.estimation.twin import TwinReading, TwinSettings
from graspforce.service import Client
from graspforce.service.recording.recording_reader import ServerRecording
from graspforce.service.replay.replay import load_hands
from graspforce.service.replay.watch import WatchedStream, watch_recording, watch_stream

_MINUTE = 60.0  # s
_TIMEOUT = 5.0  # s, for answers of the service


@dataclass(frozen=True, slots=True)
class WatchedService:
    """A service whose stream is watched.

    Args:
        address: its Zenoh endpoint; None for the default.
        stream: id of the stream; None for the only one.
        duration: time after which to end, s.
        secure: directory with certificates; None without TLS.
    """

    address: str | None
    stream: str | None
    duration: float
    secure: str | os.PathLike[str] | None = None


def run(path: Path, hands: Sequence[str], settings: TwinSettings, console: Console) -> bool:
    """Show the figures of the twins of a recording. Return whether no stream drifts.

    Args:
        path: the recording.
        hands: names or description files of hands that replace recorded ones.
        settings: limits.
        console: shows the figures.

    Raises:
        InvalidInput: no recording of a server.
        UnknownName: a hand is not found.
        ModelError: a hand cannot be read.
        OSError: the file cannot be read.
    """
    recording = ServerRecording.open(path)
    streams = watch_recording(recording, load_hands(recording, hands), settings)
    for id, stream in streams.items():
        _show(escape_controls(id), stream, console)
    if not streams:
        console.print("No stream with exact states holds an object in this recording.")
    put_result(console, {"file": path, "streams": {id: each.to_dict() for id, each in streams.items()}})
    return all(each.first_drift is None for each in streams.values())


def run_live(service: WatchedService, hands: Sequence[str], settings: TwinSettings, console: Console) -> bool:
    """Watch a running stream until it ends, Ctrl-C, or the duration, and show its figures. Return whether it does not drift.

    The first drift and each full minute are shown at once.

    Args:
        service: the service and its stream.
        hands: names or description files of hands that replace shipped ones.
        settings: limits.
        console: shows the figures.

    Raises:
        InvalidInput: the stream cannot be watched, or it is not clear which one is meant.
        ServiceError: no service, or the stream is not open.
        UnknownName: a hand is not found.
        ModelError: a hand cannot be read.
    """
    role = {} if service.secure is None else {"secure": service.secure, "name": "monitor"}
    with Client(service.address, timeout=_TIMEOUT, **role) as client, Interruption() as interruption:  # type: ignore[arg-type]
        monitor = client.monitor_stream(choose_stream(client, service.stream))
        id = escape_controls(monitor.id)
        console.print(f"Watching stream {id}. Ctrl-C ends it.", markup=False)
        has_drifted, minute, end = False, 0, time.monotonic() + service.duration

        def on_reading(reading: TwinReading) -> None:
            nonlocal has_drifted, minute
            if reading.drifts and not has_drifted:
                has_drifted = True
                console.print(_verdict(reading), soft_wrap=True)
            if int(reading.t // _MINUTE) > minute:
                minute = int(reading.t // _MINUTE)
                console.print(
                    f"{minute} min: motor share {reading.share:.3f}, residual {reading.residual:.2f}", highlight=False
                )

        def goes_on() -> bool:
            return not interruption.is_requested and time.monotonic() < end

        try:
            known = load_named(hands, monitor.hand_name)
            is_open = partial(is_stream_open, client, monitor.id)
            stream = watch_stream(monitor, known, settings, on_reading, goes_on, is_open)
        finally:
            monitor.close()
    _show(id, stream, console)
    put_result(console, {"streams": {monitor.id: stream.to_dict()}})
    return stream.first_drift is None


def _show(id: str, stream: WatchedStream, console: Console) -> None:
    """Show the figures of a stream by minute, and its first drift."""
    rows = [*stream.twin.minutes, *([] if stream.last is None else [stream.last])]
    if not rows:
        console.print(Text(f"Stream {id}: {stream.states} states, too few for a reading."))
        return
    columns = [
        ("minute", [*(str(1 + int(each.t // _MINUTE)) for each in stream.twin.minutes), "last"]),
        ("motor share", [f"{each.share:.3f}" for each in rows]),
        ("±", [f"{2.0 * each.share_error:.3f}" for each in rows]),
        ("residual", [f"{each.residual:.2f}" for each in rows]),
        ("creep mm/min", [f"{1e3 * each.creep.max():.3f}" for each in rows]),
    ]
    console.print(Text(f"Stream {id}: {stream.states} states, {rows[-1].t:.0f} s"))
    console.print(make_table(columns))
    console.print(_verdict(stream.first_drift), soft_wrap=True)


def _verdict(drift: TwinReading | None) -> Text:
    """Return the headline of a stream."""
    if drift is None:
        return Text("No drift", "bold green")
    return Text.assemble(("Drift", "bold red"), f" after {drift.t:.1f} s: {'; '.join(drift.drifts)}")
