"""``graspforce replay``: answer a server's recording again, and report differences."""

from __future__ import annotations

import typer

from graspforce.cli.commands.output_arguments import AsJson
from graspforce.cli.commands.recording_arguments import HandsInPlace, RecordingFile
from graspforce.core.optional_libraries import require_libraries

app = typer.Typer()


@app.command(epilog="Example: graspforce serve --hand four_finger --record day.mcap, then graspforce replay day.mcap")
def replay(
    file: RecordingFile,
    hand: HandsInPlace = None,
    as_json: AsJson = False,
) -> None:
    """Answer all recorded requests and step all recorded streams again, and report differences.

    Replies are compared to the bit, apart from times. Exit code 1: a reply differs without a known reason.
    """
    require_libraries("mcap", "zenoh")
    from graspforce.cli.console import ERROR, SUCCESS
    from graspforce.cli.json_output import result_console
    from graspforce.cli.run_replay import run

    raise typer.Exit(SUCCESS if run(file, hand or (), result_console(as_json)) else ERROR)
