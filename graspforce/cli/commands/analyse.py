"""``graspforce quality`` and ``graspforce explain``: measures of a grasp, and what limits its forces."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

import graspforce
from graspforce.cli.commands.output_arguments import AsJson, Force
from graspforce.cli.completions import complete_object
from graspforce.cli.console import INFEASIBLE
from graspforce.cli.output_files import check_new_file
from graspforce.core import arrays
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import decode
from graspforce.force.problem import ForceProblem
from graspforce.force.status import Status

app = typer.Typer()

File = Annotated[str, typer.Argument(metavar="FILE", help="A problem file, or - for standard input.")]
Budget = Annotated[float | None, typer.Option(metavar="S", help="Time limit; later numbers are null (default: none).")]
Direction = Annotated[
    str | None,
    typer.Option(metavar="FX,FY,FZ,MX,MY,MZ", help="Direction of the payload in O (default: the wrench of the file)."),
]
Plot = Annotated[Path | None, typer.Option(metavar="PNG", help="Write a plot: payload by direction, or the use of limits.")]
Plane = Annotated[
    str,
    typer.Option(metavar="PLANE", help="Plane of the plot: xy, xz or yz for the payload; such as fx,mz for a set of wrenches."),
]

Object = Annotated[
    str | None,
    typer.Option(
        "--object",
        metavar="OBJECT",
        autocompletion=complete_object,
        help="Surface in O, for regions of contacts: sphere:RADIUS, cylinder:RADIUS,HEIGHT, box:X,Y,Z (m), …, or a name.",
    ),
]
RegionsPlot = Annotated[
    Path | None, typer.Option(metavar="PNG", help="Write a map of the regions of contacts in which the payload is held.")
]


@app.command(epilog="Example: graspforce quality problem.json --direction 0,0,1,0,0,0")
def quality(
    file: File,
    direction: Direction = None,
    budget: Budget = None,
    plot: Plot = None,
    plane: Plane = "xz",
    payload_errors: Annotated[
        bool, typer.Option("--payload-errors", help="Also compute the errors of contacts that the payload survives.")
    ] = False,
    object_name: Object = None,
    regions_plot: RegionsPlot = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Measure the grasp of a problem file: payload, closure, Ferrari–Canny measures, ellipsoids, tolerated errors."""
    check_new_file(plot, "plot", force)
    check_new_file(regions_plot, "regions-plot", force)
    problem = load_problem(file)
    shape = None
    if object_name is not None:
        from graspforce.cli.options import parse_object  # imported here because it needs the library of hands

        shape = parse_object(object_name, None, None)[0].shape
    if regions_plot is not None and shape is None:
        raise InvalidInput("regions-plot", str(regions_plot), "absent without --object, whose surface has the regions")
    asked = _parse_direction(direction)
    answer = graspforce.quality(problem, asked, seconds=_check_budget(budget), payload_errors=payload_errors, shape=shape)
    if regions_plot is not None and answer.payload_regions is not None:
        answer.payload_regions.plot().savefig(regions_plot, dpi=110)
    if plot is not None:
        from graspforce.view import plot_payload, plot_wrench_set  # imported here because they are slow to import

        (plot_wrench_set if "," in plane else plot_payload)(problem, plane).savefig(plot, dpi=110)
    print(json.dumps(answer.to_dict()) if as_json else answer)


@app.command(epilog="Example: graspforce problems show infeasible/ball-01 | graspforce explain -")
def explain(
    file: File,
    direction: Direction = None,
    budget: Budget = None,
    plot: Plot = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Say what limits the forces of a problem file and by how much, or why there are none.

    Exit code 0: solved. 3: proven infeasible. 1: error, or no verdict.
    """
    check_new_file(plot, "plot", force)
    answer = graspforce.explain(load_problem(file), _parse_direction(direction), seconds=_check_budget(budget))
    print(json.dumps(answer.to_dict()) if as_json else answer)
    if plot is not None and answer.limits:
        answer.plot().savefig(plot, dpi=110)
    status = answer.solution.status
    raise typer.Exit(0 if answer.solution.found else INFEASIBLE if status is Status.INFEASIBLE else 1)


def load_problem(file: str) -> ForceProblem:
    """Return the problem of a file, or of standard input for "-".

    Args:
        file: path of the file, or "-".
    """
    return graspforce.load(file) if file != "-" else ForceProblem.from_dict(decode(sys.stdin.buffer.read()))


def _check_budget(budget: float | None) -> float | None:
    """Return the budget, s, if it is not negative."""
    return None if budget is None else arrays.check_number(budget, "--budget", minimum=0.0)


def _parse_direction(text: str | None) -> list[float] | None:
    """Return the six numbers of a direction."""
    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 6:
        raise InvalidInput("direction", text, "six numbers, separated by commas: a force in N and a moment in N·m")
    return numbers
