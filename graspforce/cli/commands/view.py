"""``graspforce view``: show a recording or a running stream in a web browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.commands.output_arguments import AsJson
from graspforce.cli.commands.recording_arguments import HandsInPlace
from graspforce.core.optional_libraries import require_libraries

app = typer.Typer()


@app.command(epilog="Example: graspforce simulate --save run.npz && graspforce view run.npz")
def view(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE]", help="A recording of `graspforce simulate --save`; without it, a running stream."),
    ] = None,
    gravity: Annotated[
        str, typer.Option(metavar="X,Y,Z", help="Gravity in the hand's base frame, m/s²: up in the picture of a recording.")
    ] = "0,0,-9.81",
    connect: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="Zenoh endpoint of the server (default: this machine).")
    ] = None,
    secure: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Directory of `graspforce secure init`: view with the role monitor.")
    ] = None,
    stream: Annotated[
        str | None, typer.Option(metavar="ID", help="The running stream (default: each that is open, one after another).")
    ] = None,
    hand: HandsInPlace = None,
    host: Annotated[str, typer.Option(metavar="NAME", help="Network interface; 0.0.0.0 for all.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(metavar="PORT", help="Port of the page; the next free one if it is in use.")] = 8080,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the default browser.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show a recording in a web browser, with a timeline, or without FILE the running streams of a service, until Ctrl-C.

    The page shows the hand, the object, contact forces and friction cones, which turn red near slip, and charts.

    A stream is shown 30 times a second, from copies of its messages; its driver and its server do not wait for the view.
    """
    require_libraries("mujoco", *(() if file is not None else ("zenoh",)))

    from graspforce.browser import ViewAddress
    from graspforce.cli.json_output import result_console
    from graspforce.cli.options import parse_vector
    from graspforce.core.errors import InvalidInput

    address, console = ViewAddress(host, port), result_console(as_json)
    if file is None:
        from graspforce.cli import run_stream_view

        given = run_stream_view.StreamViewOptions(connect, stream, hand or (), address, open_page, secure)
        run_stream_view.run(given, console)
        return
    from graspforce.cli import run_view

    for option, value in (("--connect", connect), ("--stream", stream), ("--secure", secure)):
        if value is not None:
            raise InvalidInput(option, str(value), "given without FILE only, for a running stream")
    run_view.run(run_view.ViewOptions(file, parse_vector(gravity, "--gravity"), address, open_page), console)
