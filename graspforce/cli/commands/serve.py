"""``graspforce serve`` and ``graspforce demo``: the service, and a service with a client."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()


@app.command(epilog="Example: graspforce serve --hand allegro_right --listen tcp/0.0.0.0:7450")
def serve(
    config: Annotated[Path | None, typer.Option(metavar="FILE", help="A Zenoh configuration file.")] = None,
    listen: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="The Zenoh endpoint to listen on; by default tcp/127.0.0.1:7450.")
    ] = None,
    hand: Annotated[list[str] | None, typer.Option(metavar="NAME", help="A hand to serve; may be given again.")] = None,
) -> None:
    """Serve force problems and hands over Zenoh until Ctrl-C or SIGTERM."""
    from graspforce.service import Server
    from graspforce.service import serve as run

    hands = hand or []

    def ready(server: Server) -> None:
        where = ", ".join(server.addresses)
        print(f"Serving on {where}; hands: {', '.join(hands) or 'none'}. Ctrl-C stops.", flush=True)

    run(hands=hands, config=config, listen=listen, on_ready=ready)


@app.command(epilog="Example: graspforce demo --steps 200 --out carry.png")
def demo(
    steps: Annotated[int, typer.Option(metavar="N", help="Instants along the path, one query each.")] = 500,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the picture goes.")] = Path("out/carry.png"),
) -> None:
    """Start a service, carry a box with the four-finger hand, one query a step; show a table and a picture of the forces."""
    from rich.console import Console

    from graspforce.cli.run_demo import run

    raise typer.Exit(0 if run(steps, out, Console(highlight=False)) else 1)
