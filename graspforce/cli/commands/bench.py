"""``graspforce bench``: the benchmark of solvers on the problem library."""

from __future__ import annotations

import dataclasses
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from graspforce.cli.commands.output_arguments import AsJson
from graspforce.cli.commands.problems import OwnProblems, choose_problems
from graspforce.cli.completions import complete_case, complete_collection
from graspforce.cli.console import print_report, progress_console
from graspforce.cli.json_output import print_json
from graspforce.core import arrays

app = typer.Typer()


@app.command(epilog="Example: graspforce bench --collection textbook --solver clarabel --solver proxqp")
def bench(
    collection: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="A collection of `graspforce problems`; repeatable.", autocompletion=complete_collection
        ),
    ] = None,
    case: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A case instead of collections; repeatable.", autocompletion=complete_case),
    ] = None,
    smoke: Annotated[bool, typer.Option("--smoke", help="Run the small set of 160 cases instead of collections.")] = False,
    solver: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A solver, or a module with an adapter; repeatable.")
    ] = None,
    answers: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE", help="Answers to judge without running their solver: .parquet, .json or .csv; repeatable."
        ),
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Accuracy: default, high, low or float32; repeatable.")
    ] = None,
    units: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Units: scaled (default) or si; repeatable.")] = None,
    folder: OwnProblems = None,
    max_cases: Annotated[
        int, typer.Option(metavar="N", help="Maximum number of cases per collection, evenly spaced; 0 for all.")
    ] = 40,
    limit: Annotated[
        float, typer.Option("--time-limit", metavar="S", help="Processor time after which a solver is stopped, s.")
    ] = 2.0,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask scheduler whose workers run the solvers, such as tcp://host:8786."),
    ] = None,
    workers: Annotated[int, typer.Option(metavar="N", help="Number of solvers that run at once on this machine.")] = 1,
    save: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Save outcomes here; cases that the file already holds are skipped.")
    ] = None,
    compare: Annotated[
        Path | None, typer.Option("--compare-with", metavar="FILE", help="Outcomes of an earlier run; show what differs.")
    ] = None,
    report: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Folder for report.md and its figures.")] = None,
    site: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Folder for a static page, index.html.")] = None,
    as_json: AsJson = False,
) -> None:
    """Compare solvers on force problems with proven answers. Every answer is judged by its certificate."""
    from graspforce import problems
    from graspforce.bench import race
    from graspforce.bench.outcome import load
    from graspforce.cli.tables import difference_table, race_tables

    arrays.check_number(limit, "--time-limit", above=0.0)
    choose_problems(folder)
    cases = (*(case or ()), *(problems.smoke_names() if smoke else ()))
    race_plan = race.make_race_plan(solver or (), settings or (), units or (), collection or (), max_cases, limit, cases)
    race_plan = dataclasses.replace(race_plan, pyramid_contacts=race.SMOKE_PYRAMID_CONTACTS if smoke else 0)
    before = None if compare is None else load(compare)[1]
    run = (lambda: _race(race_plan, save, cluster, workers)) if solver or not answers else None
    facts, outcomes = _outcomes(race_plan, answers or (), run)
    if as_json:
        print_json({"facts": facts, "outcomes": [outcome.to_dict() for outcome in outcomes]})
    else:
        for table in race_tables(outcomes, limit):
            print_report(table)
        if before is not None:
            print_report(difference_table(before, outcomes))
    chosen = ["--smoke"] if smoke else [] if case else [f"--max-cases {max_cases}"]
    named: dict[str, Sequence[object] | None] = {"collection": collection, "case": case, "solver": solver, "answers": answers}
    named |= {"settings": settings, "units": units, "dir": None if folder is None else [folder]}
    command = " ".join(["graspforce bench", *_options(named), *chosen, f"--time-limit {limit:g}"])
    stream = sys.stderr if as_json else sys.stdout
    if report is not None:
        from graspforce.bench.report import write

        print(f"Report: {write(report, facts, outcomes, f'{command} --report {report}')}", file=stream)
    if site is not None:
        from graspforce.bench.site import write_site

        print(f"Page: {write_site(site, facts, outcomes, command, folder, answers or ())}", file=stream)


def _options(named: Mapping[str, Sequence[object] | None]) -> list[str]:
    """Return the words of repeatable options, quoted for a shell."""
    return [f"--{name} {shlex.quote(str(value))}" for name, values in named.items() for value in values or ()]


def _outcomes(
    race_plan: Any, answers: Sequence[Path], run: Callable[[], tuple[dict[str, Any], list[Any]]] | None
) -> tuple[dict[str, Any], list[Any]]:
    """Return the conditions and outcomes of the race and of the answers.

    Args:
        race_plan: the plan of the race.
        answers: files with answers of solvers that do not run here.
        run: function that runs the race; None to judge the answers only.
    """
    from graspforce.bench.answers import check_unique, judge_answers, load_answers
    from graspforce.bench.conditions import race_conditions

    given = {path.stem: load_answers(path) for path in answers}
    for rows in given.values():
        check_unique(rows)
    reported = [outcome for solver, rows in given.items() for outcome in judge_answers(solver, rows)]
    facts, outcomes = run() if run is not None else (race_conditions((), race_plan.limit), [])
    versions = {**facts["versions"], **{path.stem: "(answers only, times reported)" for path in answers}}
    return {**facts, "versions": versions}, [*outcomes, *reported]


def _race(race_plan: Any, save: Path | None, cluster: str | None, workers: int) -> Any:
    """Run the race with a progress bar."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from graspforce.bench import race

    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=progress_console(), transient=True) as bar:
        shown = bar.add_task("", total=None)

        def show(what: str, done: int, of: int) -> None:
            bar.update(shown, description=what, completed=done, total=of)

        return race.run(race_plan, save, show, cluster, workers)
