"""The command ``graspforce watch``: compare recorded streams with the model, and show drift."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.text import Text

from graspforce.cli.json_output import put_result
from graspforce.cli.tables import make_table
from graspforce.core.printable import escape_controls
from graspforce.estimation.twin import TwinReading, TwinSettings
from graspforce.service.recording.recording_reader import ServerRecording
from graspforce.service.replay.replay import load_hands
from graspforce.service.replay.watch import WatchedStream, watch_recording

_MINUTE = 60.0  # s


def run(path: Path, hands: Sequence[str], settings: TwinSettings, console: Console) -> bool:
    """Show the figures of the twins. Return whether no stream drifts.

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
