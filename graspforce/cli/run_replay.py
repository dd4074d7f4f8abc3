"""The command ``graspforce replay``: answer a recording again, and show the differences."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.text import Text

from graspforce.cli.console import progress_console
from graspforce.cli.json_output import put_result
from graspforce.cli.tables import NO_VALUE, count_text, make_table
from graspforce.core.printable import escape_controls
from graspforce.service.recording.recording_reader import ServerRecording
from graspforce.service.replay.replay import Replay, load_hands
from graspforce.service.replay.report import ReplayReport, SourceResult

_SHOWN_EVERY = 1000  # exchanges


def run(path: Path, hands: Sequence[str], console: Console) -> bool:
    """Replay a recording and show the report. Return whether no reply differs without a known reason.

    Args:
        path: the recording.
        hands: names or description files of hands that replace recorded ones.
        console: shows the report.

    Raises:
        InvalidInput: no recording of a server.
        UnknownName: a hand is not found.
        ModelError: a hand cannot be read.
        OSError: the file cannot be read.
    """
    recording = ServerRecording.open(path)
    with progress_console().status("Replaying") as status:

        def show(count: int) -> None:
            if count % _SHOWN_EVERY == 0:
                status.update(f"Replaying: {count} exchanges")

        report = Replay(recording, load_hands(recording, hands), show).run()
    _show(report, console)
    put_result(console, {**report.to_dict(), "file": path})
    return report.is_equal


def _show(report: ReplayReport, console: Console) -> None:
    """Show a report."""
    results = list(report.sources.items())
    columns = [
        ("source", [escape_controls(name) for name, _ in results]),
        ("exchanges", [str(each.count) for _, each in results]),
        ("equal", [str(each.equal) for _, each in results]),
        ("different", [str(each.different) for _, each in results]),
        ("explained", [_reasons(each) for _, each in results]),
    ]
    console.print(make_table(columns))
    for name, each in results:
        for number, difference in each.examples:
            console.print(Text(escape_controls(f"{name}, exchange {number}: {difference}")), soft_wrap=True)
    for name, count in report.dropped.items():
        console.print(Text(escape_controls(f"{name}: {count} exchanges were dropped while recording")), soft_wrap=True)
    for note in report.notes:
        console.print(Text(escape_controls(f"Note: {note}")), soft_wrap=True)
    verdict = "no differences" if report.is_equal else "replies differ"
    colour = "bold green" if report.is_equal else "bold red"
    equal = f"{report.equal} of {count_text(report.count, 'exchange')} equal to the bit"
    console.print(Text.assemble((f"Replay: {verdict}", colour), f"; {equal}"))


def _reasons(result: SourceResult) -> str:
    """Return the counts of a result by reason."""
    return ", ".join(f"{count}: {reason}" for reason, count in result.explained.items()) or NO_VALUE
