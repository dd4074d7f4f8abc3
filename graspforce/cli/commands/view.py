"""``graspforce view``: show a recording in a web browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.commands.output_arguments import AsJson
from graspforce.core.optional_libraries import require_libraries

app = typer.Typer()


@app.command(epilog="Example: graspforce simulate --save run.npz && graspforce view run.npz")
def view(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording that `graspforce simulate --save` wrote.")],
    gravity: Annotated[
        str, typer.Option(metavar="X,Y,Z", help="Gravity in the hand's base frame, m/s²: up in the picture.")
    ] = "-9.81,0,0",
    host: Annotated[str, typer.Option(metavar="NAME", help="Network interface; 0.0.0.0 for all.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(metavar="PORT", help="Port of the page; the next free one if it is in use.")] = 8080,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the default browser.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show a recording in a web browser, with a timeline, until Ctrl-C.

    The page shows the hand, the object, contact forces and friction cones, which turn red near slip, and charts.
    """
    require_libraries("mujoco")

    from graspforce.browser import ViewAddress
    from graspforce.cli import run_view
    from graspforce.cli.json_output import result_console
    from graspforce.cli.options import parse_vector

    options = run_view.ViewOptions(file, parse_vector(gravity, "--gravity"), ViewAddress(host, port), open_page)
    run_view.run(options, result_console(as_json))
