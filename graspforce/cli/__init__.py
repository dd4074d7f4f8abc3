"""The command ``graspforce``: solve problem files, look at cases and hands, race solvers, serve, plan and simulate.

Exit codes: 0 an answer, 2 a proof that there is none, 1 an error (also a wrong command line). Errors are one line on stderr,
in the words of the Python exception. Rooms that take long to import are imported by the command that needs them.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer

import graspforce
from graspforce.cli.commands import hands, plan, problems, serve, solve
from graspforce.cli.console import print_error
from graspforce.core.errors import GraspForceError

_UsageError: Any = typer.BadParameter.__mro__[1]  # UsageError, which Typer raises on a wrong command line and does not export

app = typer.Typer(
    help="Fingertip forces inside their friction cones with least motor torque, certified.",
    epilog="Example: graspforce problems show ring/3-force | graspforce solve -",
    invoke_without_command=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for commands in (solve, problems, hands, serve, plan):
    app.add_typer(commands.app)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Args:
        arguments: what follows the command's name; by default what the shell gave.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without μ shows ? rather than a traceback
    try:
        code = app(args=arguments, prog_name="graspforce", standalone_mode=False)
    except _UsageError as error:
        return print_error(f"{error.format_message()} (graspforce --help lists what there is)")
    except GraspForceError as error:
        return print_error(str(error))
    except OSError as error:  # a disk that is full, a file that another program has taken away
        return print_error(f"{error.filename or 'writing'}: {error.strerror or error}")
    return code if isinstance(code, int) else 0


def _version(is_set: bool) -> None:
    if is_set:
        print(f"graspforce {graspforce.__version__}")
        raise typer.Exit


@app.callback()
def _root_command(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say the version and stop.")
    ] = False,
) -> None:
    """Fingertip forces inside their friction cones with least motor torque, certified."""
    if context.invoked_subcommand is None:
        print(context.get_help())
