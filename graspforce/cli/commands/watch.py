"""``graspforce watch``: compare streams, recorded or running, with the model of hand and object."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.commands.output_arguments import AsJson
from graspforce.cli.commands.recording_arguments import HandsInPlace
from graspforce.core.optional_libraries import require_libraries

app = typer.Typer()


@app.command(epilog="Example: graspforce watch --connect tcp/127.0.0.1:7450")
def watch(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE]", help="A recording of `graspforce serve --record`; without it, a running stream."),
    ] = None,
    connect: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="Zenoh endpoint of the server (default: this machine).")
    ] = None,
    secure: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Directory of `graspforce secure init`: watch with the role monitor.")
    ] = None,
    stream: Annotated[str | None, typer.Option(metavar="ID", help="The running stream (default: the only one).")] = None,
    duration: Annotated[
        float, typer.Option(metavar="S", min=0.0, help="End after this time, with a running stream.")
    ] = math.inf,
    hand: HandsInPlace = None,
    window: Annotated[float, typer.Option(metavar="TIME", help="Time over which the share is estimated (s).")] = 4.0,
    share_limit: Annotated[
        float, typer.Option(metavar="X", help="Deviation of the motors' share of the commanded torque from 1 that is drift.")
    ] = 0.1,
    creep_limit: Annotated[float, typer.Option(metavar="M", help="Sliding of a fingertip that is drift, m/min.")] = 2e-3,
    as_json: AsJson = False,
) -> None:
    """Compare streams that hold an object with the model, and report drift: a running one, or those of a recording.

    The report has the motors' share of the commanded torques, what it does not explain, and the creep of the fingertips, by
    minute. A running stream is watched until it ends, or Ctrl-C; its driver and its server do not wait for this.

    Exit code 1: a stream drifts.
    """
    require_libraries(*(() if file is None else ("mcap",)), "zenoh")
    from graspforce.cli import run_watch
    from graspforce.cli.console import ERROR, SUCCESS
    from graspforce.cli.json_output import result_console
    from graspforce.core.errors import InvalidInput
    from graspforce.estimation.twin import TwinSettings

    settings, console = TwinSettings(window=window, share_limit=share_limit, creep_limit=creep_limit), result_console(as_json)
    if file is None:
        service = run_watch.WatchedService(connect, stream, duration, secure)
        raise typer.Exit(SUCCESS if run_watch.run_live(service, hand or (), settings, console) else ERROR)
    for option, value in (("--connect", connect), ("--stream", stream), ("--secure", secure)):
        if value is not None:
            raise InvalidInput(option, str(value), "given without FILE only, for a running stream")
    raise typer.Exit(SUCCESS if run_watch.run(file, hand or (), settings, console) else ERROR)
