"""``graspforce top``: streams, clients and latencies of a running server."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.commands.output_arguments import AsJson
from graspforce.cli.console import print_report, report_console

app = typer.Typer()


@app.command(epilog="Example: graspforce top --connect tcp/127.0.0.1:7450")
def top(
    connect: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="Zenoh endpoint of the server (default: this machine).")
    ] = None,
    secure: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Directory of `graspforce secure init`, for a server with --secure.")
    ] = None,
    name: Annotated[str, typer.Option(metavar="NAME", help="Name of the certificate, with --secure.")] = "monitor",
    period: Annotated[float, typer.Option(metavar="S", min=0.05, help="Time between two readings, s.")] = 1.0,
    once: Annotated[bool, typer.Option("--once", help="Print one reading, and stop.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show streams, clients and latencies of a running server until Ctrl-C.

    Latencies are those since the server started; the median and 99 % are bounds of histogram buckets.

    Exit code 1: no server answers, or the server cannot take work (with --once and --json, which print one reading).
    """
    from graspforce.cli.server_tables import server_report
    from graspforce.service import Client

    with Client(connect, secure=secure, name=name) as client:
        status = client.status()
        if as_json:
            print(json.dumps(status.to_dict(), indent=2))
        elif once:
            print_report(server_report(status))
        if as_json or once:
            raise typer.Exit(0 if status.problem is None else 1)
        from rich.live import Live

        try:
            with Live(server_report(status), console=report_console(), screen=True, auto_refresh=False) as live:
                while True:
                    time.sleep(period)
                    previous, status = status, client.status()
                    live.update(server_report(status, previous), refresh=True)
        except KeyboardInterrupt:
            print_report(server_report(status))
