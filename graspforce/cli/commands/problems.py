"""``graspforce problems``: the problem library."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from graspforce.cli.commands.output_arguments import AsJson
from graspforce.cli.completions import complete_case
from graspforce.cli.console import print_report, progress_console
from graspforce.cli.json_output import print_json

app = typer.Typer()
problems_app = typer.Typer(
    help="List, show and verify force problems with proven answers.", epilog="Example: graspforce problems"
)
app.add_typer(problems_app, name="problems", invoke_without_command=True)


OwnProblems = Annotated[
    Path | None,
    typer.Option("--dir", metavar="FOLDER", help="Folder of collections to use instead of the library."),
]


def choose_problems(folder: Path | None) -> None:
    """Use the problems of a folder, if one is given.

    Args:
        folder: folder of collections, or None.
    """
    if folder is not None:
        from graspforce import problems

        problems.choose_folder(folder)


@problems_app.callback()
def _problems(context: typer.Context, folder: OwnProblems = None, as_json: AsJson = False) -> None:
    """List the collections of force problems. Subcommands list, show, verify and export cases."""
    choose_problems(folder)
    if context.invoked_subcommand is None:
        from graspforce import problems
        from graspforce.cli.tables import collection_list

        found = [(name, len(problems.names(name)), problems.describe(name)) for name in problems.collections()]
        if as_json:
            keys = ("name", "cases", "description")
            print_json({"collections": [dict(zip(keys, each, strict=True)) for each in found]})
        else:
            print_report(collection_list(found))


@problems_app.command("list", epilog="Example: graspforce problems list nose-cone")
def list_problems(
    collection: Annotated[
        str | None, typer.Argument(metavar="COLLECTION", help="A collection, or textbook for all derived ones (default: all).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List cases with their contacts, objective, cone, answer and source."""
    from graspforce import problems
    from graspforce.cli.tables import case_list

    cases = [problems.load(name) for name in problems.names(collection)]
    if as_json:
        print_json({"cases": [_case_record(case) for case in cases]})
    else:
        print_report(case_list(cases))


def _case_record(case: Any) -> dict[str, object]:
    """Return name, size, answer and source of a case."""
    return {
        "name": case.name,
        "contacts": len(case.problem.contacts),
        "objective": case.problem.objective.type,
        "cone": case.problem.cone.type,
        "expected": case.expected.status,
        "source": case.source,
    }


@problems_app.command("show", epilog="Example: graspforce problems show opposed/torque-limit | graspforce solve -")
def show_problem(
    name: Annotated[
        str,
        typer.Argument(metavar="NAME", help="Name of a case (see `graspforce problems list`).", autocompletion=complete_case),
    ],
) -> None:
    """Print a case as JSON: the problem and its proven answer."""
    from graspforce import problems

    print(problems.text(name), end="")


@problems_app.command("verify", epilog="Example: graspforce problems verify hard soft")
def verify_problems(
    collection: Annotated[
        list[str] | None, typer.Argument(metavar="[COLLECTION]...", help="Collections to check (default: all).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Solve every case again and check every certificate and proof. Exit code 1: a check failed."""
    from rich.progress import track

    from graspforce import problems
    from graspforce.bench.library_check import summarize_checks, verify_case
    from graspforce.cli.tables import collection_summary_table

    names = [name for one in collection or problems.collections() for name in problems.names(one)]
    console = progress_console()
    checks = [verify_case(problems.load(name)) for name in track(names, "Verifying", console=console, transient=True)]
    found = list(summarize_checks(checks))
    if as_json:
        print_json({"collections": found})
    else:
        print_report(collection_summary_table(found))
    raise typer.Exit(int(any(tally.failed for tally in found)))


@problems_app.command("export", epilog="Example: graspforce problems export graspforce-problems")
def export_problems(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="New or empty folder for the package.")],
    collection: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A collection; repeatable (default: all).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write the data package graspforce-problems: Parquet, JSON, CBF and QPS with optima, multipliers and rays."""
    from rich.progress import Progress

    from graspforce import problems
    from graspforce.bench.export.data_package import write_data_package

    names = [name for one in collection or problems.collections() for name in problems.names(one)]
    with Progress(console=progress_console(), transient=True) as bar:
        task = bar.add_task("Writing", total=len(names))
        manifest = write_data_package(folder, names, lambda done, of: bar.update(task, completed=done, total=of))
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    if as_json:
        found = {"cases": len(manifest["cases"]), "version": manifest["version"], "bytes": size}
        return print_json({"folder": str(folder), **found, "files": manifest["files"]})
    return print(f"{folder}: {len(manifest['cases'])} cases, version {manifest['version']}, {size / 1e6:.1f} MB")
