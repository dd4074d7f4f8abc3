"""``graspforce watch``: compare recorded streams with the model of hand and object."""

from __future__ import annotations

from typing import Annotated

import typer

from graspforce.cli.commands.output_arguments import AsJson
from graspforce.cli.commands.recording_arguments import HandsInPlace, RecordingFile
from graspforce.core.optional_libraries import require_libraries

app = typer.Typer()


@app.command(epilog="Example: graspforce serve --hand four_finger --record day.mcap, then graspforce watch day.mcap")
def watch(
    file: RecordingFile,
    hand: HandsInPlace = None,
    window: Annotated[float, typer.Option(metavar="TIME", help="Time over which the share is estimated (s).")] = 4.0,
    share_limit: Annotated[
        float, typer.Option(metavar="X", help="Deviation of the motors' share of the commanded torque from 1 that is drift.")
    ] = 0.1,
    creep_limit: Annotated[float, typer.Option(metavar="M", help="Sliding of a fingertip that is drift, m/min.")] = 2e-3,
    as_json: AsJson = False,
) -> None:
    """Compare the recorded streams that hold an object with the model, and report drift.

    The report has the motors' share of the commanded torques, what it does not explain, and the creep of the fingertips, by
    minute. Exit code 1: a stream drifts.
    """
    require_libraries("mcap", "zenoh")
    from graspforce.cli.console import ERROR, SUCCESS
    from graspforce.cli.json_output import result_console
    from graspforce.cli.run_watch import run
    from graspforce.estimation.twin import TwinSettings

    settings = TwinSettings(window=window, share_limit=share_limit, creep_limit=creep_limit)
    raise typer.Exit(SUCCESS if run(file, hand or (), settings, result_console(as_json)) else ERROR)
