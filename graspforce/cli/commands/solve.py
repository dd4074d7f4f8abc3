"""``graspforce solve`` and ``graspforce backends``: solve a problem file, and list the solvers."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import Annotated

import typer

import graspforce
from graspforce.cli.commands.output_arguments import AsJson, Force
from graspforce.cli.completions import complete_backend
from graspforce.cli.console import INFEASIBLE, print_error, print_report
from graspforce.cli.output_files import check_new_file
from graspforce.contact.friction import PYRAMID_SIDES
from graspforce.core import fields
from graspforce.core.errors import GraspForceError, InvalidInput
from graspforce.core.json_text import decode
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Cone
from graspforce.force.proof_file import write_proof
from graspforce.force.solution import Solution
from graspforce.force.status import Status

app = typer.Typer()


@app.command(epilog="Example: graspforce solve problem.json --cone inner:8 --backend proxqp")
def solve(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A problem file, or - for standard input.")],
    backend: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Solver to use (see `graspforce backends`).", autocompletion=complete_backend),
    ] = None,
    cone: Annotated[
        str | None,
        typer.Option(metavar="CONE", help="Friction cone: exact, inner:FACETS or outer:FACETS (default: that of the file)."),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
    proof: Annotated[
        str | None,
        typer.Option(metavar="PROOF", help="Write a proof of the verdict, for a checker in exact arithmetic."),
    ] = None,
    plot: Annotated[str | None, typer.Option(metavar="PNG", help="Write a picture of the forces in their cones.")] = None,
) -> None:
    """Solve a problem file, and show forces, torques and certificate, or why the problem is infeasible.

    Exit code 0: solved. 3: proven infeasible. 1: error, or no verdict.
    """
    problem = graspforce.load(file) if file != "-" else ForceProblem.from_dict(decode(sys.stdin.buffer.read()))
    if cone is not None:
        problem = dataclasses.replace(problem, cone=_parse_cone(cone))
    for path, option in ((proof, "--proof"), (plot, "--plot")):
        check_new_file(None if path is None else Path(path), option, force)
    answer = graspforce.solve(problem, backend)
    if proof is not None and (answer.found or answer.status is Status.INFEASIBLE):
        write_proof(answer, proof)
    if plot is not None:
        from graspforce.view import show  # imported here because it is slow to import

        show(problem, answer).savefig(plot, dpi=110)
    if as_json:
        _ = None if answer.robust is None else answer.robust.error_factor  # its record has them only if they were computed
        print(json.dumps(answer.to_dict()))
    else:
        from graspforce.cli.tables import solution_report

        print_report(solution_report(problem, answer))
    raise typer.Exit(_exit_code(answer))


def _parse_cone(text: str) -> Cone:
    """Return the cone that a text such as exact, inner:8 or outer:16 names."""
    if text == "exact":
        return Cone()
    side, _, facets = text.partition(":")
    if side not in PYRAMID_SIDES or not facets.isdecimal():
        raise InvalidInput("cone", text, "exact, inner:FACETS or outer:FACETS")
    try:
        return Cone("pyramid", int(facets), fields.check_choice(side, "side", PYRAMID_SIDES))
    except InvalidInput as error:
        raise error.with_prefix("cone") from None


def _exit_code(answer: Solution) -> int:
    """Return the exit code of a solution; warn on standard error if it is inaccurate or failed."""
    if answer.status is Status.INFEASIBLE:
        return INFEASIBLE
    if answer.status is Status.FAILED:
        return print_error(answer.status.sentence)
    if answer.status is Status.INACCURATE:
        print(f"Warning: {answer.status.sentence}", file=sys.stderr)
    return 0


@app.command(epilog="Example: graspforce backends")
def backends(as_json: AsJson = False) -> None:
    """List the installed solvers, and whether each solves exact cones and pyramids."""
    from rich.table import Table

    from graspforce import problems
    from graspforce.cli.json_output import print_json

    cases = {"exact cones": "ring/3-force", "pyramids": "ring/3-inner-8"}
    support = {
        name: {kind: _support_text(name, problems.load(case).problem) for kind, case in cases.items()}
        for name in graspforce.available_backends()
    }
    if as_json:
        print_json({"backends": support})
        return
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("solver")
    for kind in cases:
        table.add_column(kind)
    for name, by_kind in support.items():
        table.add_row(name, *by_kind.values())
    print_report(table)


def _support_text(backend: str, problem: ForceProblem) -> str:
    try:
        answer = graspforce.solve(problem, backend)
    except GraspForceError:
        return "no"
    return "yes, verified" if answer.backend == backend else f"not verified; solved by {answer.backend}"
