"""The command ``graspforce``: solve problems, show cases and hands, benchmark solvers, serve, plan and simulate.

Exit codes: 0 success, 1 error or failed run, 2 wrong command line, 3 proven infeasible. An error is one line on standard error:
the text of the Python exception. Each command imports the packages that it needs, so that the command starts fast.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer

import graspforce
from graspforce.cli.commands import (
    analyse,
    ask,
    bench,
    cycle,
    glove,
    grasp,
    hands,
    learn,
    plan,
    problems,
    regrasp,
    replay,
    secure,
    serve,
    simulate,
    solve,
    top,
    view,
    watch,
)
from graspforce.cli.console import INTERRUPTED, USAGE, print_error
from graspforce.core.errors import GraspForceError
from graspforce.core.optional_libraries import optional_imports

_UsageError: Any = typer.BadParameter.__mro__[1]  # UsageError, which Typer raises on a wrong command line and does not export

app = typer.Typer(
    help="Compute, certify and control the contact forces of multi-finger hands.",
    epilog="Exit codes: 0 success, 1 error or failed run, 2 wrong command line, 3 proven infeasible.\n\n"
    "Example: graspforce problems show ring/3-force | graspforce solve -",
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for commands in (
    solve,
    analyse,
    problems,
    bench,
    hands,
    grasp,
    glove,
    learn,
    serve,
    top,
    ask,
    secure,
    plan,
    simulate,
    cycle,
    regrasp,
    view,
    replay,
    watch,
):
    app.add_typer(commands.app)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Args:
        arguments: words after the command's name (default: those of the shell).
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without μ shows ? instead of a traceback
    try:
        with optional_imports():
            code = app(args=arguments, prog_name="graspforce", standalone_mode=False)
    except _UsageError as error:
        return print_error(f"{error.format_message()} (see graspforce --help)", USAGE)
    except GraspForceError as error:
        return print_error(str(error))
    except OSError as error:  # for example a full disk
        return print_error(f"{error.filename or 'writing'}: {error.strerror or error}")
    if code == INTERRUPTED:  # Typer's code for Ctrl-C
        return print_error("interrupted", INTERRUPTED)
    return code if isinstance(code, int) else 0


def _version(is_set: bool) -> None:
    if is_set:
        print(f"graspforce {graspforce.__version__}")
        raise typer.Exit


@app.callback()
def _root_command(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Compute, certify and control the contact forces of multi-finger hands."""
    if context.invoked_subcommand is None:
        print(context.get_help())
