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
    role: Annotated[
        str | None, typer.Option(metavar="ROLE", help="controller or monitor (default: the present role, or monitor).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Issue or renew the certificate of a client. Restart the server, so that it learns a new name."""
    from graspforce.service.security.directory import add_client

    role = add_client(directory, name, role)
    if as_json:
        print(json.dumps({"name": name, "role": role, "files": [str(directory / f"{name}{end}") for end in (".pem", ".key")]}))
        return
    print(f"Wrote {directory / f'{name}.pem'} and {directory / f'{name}.key'}: a {role}.")


@secure.command(epilog="Example: graspforce secure renew robot-keys")
def renew(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Directory of `graspforce secure init`.")],
    host: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Further name or address by which clients reach the server; repeatable."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Issue a new certificate for the server. Restart the server, so that it uses it."""
    from graspforce.service.security.directory import SERVER, renew_server

    renew_server(directory, host or ())
    path = directory / f"{SERVER}.pem"
    print(json.dumps({"file": str(path)}) if as_json else f"Wrote {path}. Restart the server.")


@secure.command(epilog="Example: graspforce secure rotate robot-keys")
def rotate(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Directory of `graspforce secure init`.")],
    finish: Annotated[bool, typer.Option("--finish", help="Remove the earlier authority.")] = False,
    as_json: AsJson = False,
) -> None:
    """Replace the certificate authority, in two steps between which old and new certificates are valid."""
    from graspforce.service.security.directory import begin_rotation, finish_rotation

    (finish_rotation if finish else begin_rotation)(directory)
    if as_json:
        print(json.dumps({"directory": str(directory), "finished": finish}))
        return
    done = "Removed the earlier authority." if finish else "Renew the server and add all clients again, then use --finish."
    print(f"Copy ca.pem to all machines, and restart the server. {done}")
