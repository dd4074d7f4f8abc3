"""``graspforce hands``: list and show hands, and check hand models."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from graspforce.cli.console import print_report

app = typer.Typer()
hands_app = typer.Typer(help="List and show hands, and check hand models.", epilog="Example: graspforce hands")
app.add_typer(hands_app, name="hands", invoke_without_command=True)


@hands_app.callback()
def _hands(context: typer.Context) -> None:
    """List the hands that ship. `show` describes one; `lint` checks a model."""
    if context.invoked_subcommand is None:
        from graspforce.hand.description import find, read_description, shipped_hands

        for name in shipped_hands():
            print(f"{name:20}{read_description(find(name)).title}")


@hands_app.command("show", epilog="Example: graspforce hands show four_finger")
def show_hand(
    name: Annotated[str, typer.Argument(metavar="NAME", help="A name of `graspforce hands`, or a description file.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print the record as JSON.")] = False,
) -> None:
    """Describe a hand: fingers, joints, limits, couplings and sources."""
    from graspforce.hand.hand import Hand

    record = Hand.load(name).describe()
    if as_json:
        print(json.dumps(record))
    else:
        from graspforce.cli.tables import hand_report

        print_report(hand_report(record))


@hands_app.command(epilog="Example: graspforce hands lint my_hand.urdf")
def lint(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A URDF, a description file, or a shipped hand's name.")],
) -> None:
    """Check a hand model for physically impossible values, and show their effect. Exit code 1: errors were found."""
    from graspforce.cli.tables import findings_report
    from graspforce.hand.lint import lint_hand

    findings = lint_hand(file)
    print_report(findings_report(findings))
    raise typer.Exit(int(any(finding.severity == "error" for finding in findings)))
