"""``graspforce ask``: send a record to a key of a server."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from graspforce.core.json_text import decode, read

app = typer.Typer()


@app.command(epilog="Example: graspforce problems show ring/3-force | graspforce ask solve -")
def ask(
    key: Annotated[str, typer.Argument(metavar="KEY", help="Key after graspforce/1/, such as hands/dlr_hit2/forward.")],
    file: Annotated[
        str | None, typer.Argument(metavar="[FILE]", help="Record as JSON, or - for standard input (default: {}).")
    ] = None,
    connect: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="Zenoh endpoint of the server (default: this machine).")
    ] = None,
    secure: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Directory of `graspforce secure init`, for a server with --secure.")
    ] = None,
    name: Annotated[str, typer.Option(metavar="NAME", help="Name of the certificate, with --secure.")] = "controller",
    budget: Annotated[float, typer.Option(metavar="S", min=0.01, help="Time for the answer, s.")] = 10.0,
) -> None:
    """Send a record to a key of a server, and print the answer as JSON.

    The wire page of the documentation lists the keys and their records.

    Exit code 0: an answer. 1: an error, also one that the server sent.
    """
    from graspforce.core.errors import InvalidInput
    from graspforce.service import Client

    if file is None:
        record: object = {}
    else:
        record = decode(sys.stdin.buffer.read()) if file == "-" else read(file)
    if not isinstance(record, dict):
        raise InvalidInput("FILE", record, "a JSON object")
    with Client(connect, timeout=budget, secure=secure, name=name) as client:
        print(json.dumps(client.query(key, record), indent=2, ensure_ascii=False))
