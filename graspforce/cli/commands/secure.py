"""``graspforce secure``: certificates and roles for a service in a network."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.commands.output_arguments import AsJson

app = typer.Typer()
secure = typer.Typer(no_args_is_help=True, help="Make certificates for TLS, and control access to the service by role.")
app.add_typer(secure, name="secure")


@secure.command(epilog="Example: graspforce secure init robot-keys --host robot.local")
def init(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="New directory for keys, certificates and roles.")],
    host: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Name or address by which clients reach the server, beside localhost; repeatable."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Make a private certificate authority, and certificates of the server, a controller and a monitor."""
    from graspforce.service.security.directory import init_directory

    init_directory(directory, host or ())
    if as_json:
        print(json.dumps({"directory": str(directory)}))
        return
    print(
        f"Made {directory}. Serve with `graspforce serve --secure {directory}`. Copy ca.pem and the .pem and .key of a client"
    )
    print("to its machine, and keep ca.key in a safe place.")


@secure.command(epilog="Example: graspforce secure add robot-keys arm-7 --role controller")
def add(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Directory of `graspforce secure init`.")],
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the client.")],
    role: Annotated[str, typer.Option(metavar="ROLE", help="controller or monitor.")] = "monitor",
    as_json: AsJson = False,
) -> None:
    """Issue or renew the certificate of a client. Restart the server, so that it learns a new name."""
    from graspforce.service.security.directory import add_client

    add_client(directory, name, role)
    if as_json:
        print(json.dumps({"name": name, "role": role, "files": [str(directory / f"{name}{end}") for end in (".pem", ".key")]}))
        return
    print(f"Wrote {directory / f'{name}.pem'} and {directory / f'{name}.key'}: a {role}.")
