"""Options of commands that search a grasp: hand, object, fingers, gravity."""

from __future__ import annotations

from typing import Annotated

import typer

from graspforce.cli.completions import complete_hand, complete_object

ObjectName = Annotated[
    str,
    typer.Option(
        "--object",
        metavar="OBJECT",
        autocompletion=complete_object,
        help="sphere:RADIUS, cylinder:RADIUS,HEIGHT, box:X,Y,Z, superquadric:A,B,C,E1,E2 (m), mesh:FILE[,SCALE], or a name.",
    ),
]
Mass = Annotated[float | None, typer.Option(metavar="KG", help="Mass, kg (default: 0.05, or that of the named object).")]
Friction = Annotated[
    float | None, typer.Option(metavar="MU", help="Friction coefficient (default: 0.7, or that of the named object).")
]
Fingers = Annotated[str | None, typer.Option(metavar="A,B,C", help="Fingers to use (default: chosen automatically).")]
Gravity = Annotated[str, typer.Option(metavar="X,Y,Z", help="Gravity in the hand's base frame, m/s².")]
Seed = Annotated[int, typer.Option(metavar="N", help="Random seed for the grasp search.")]
HandName = Annotated[
    str,
    typer.Option(
        metavar="NAME", help="Name of a hand (see `graspforce hands`), or a description file.", autocompletion=complete_hand
    ),
]
GraspClassName = Annotated[
    str | None, typer.Option("--class", metavar="NAME", help="Class of the grasp, such as pinch, tripod or power.")
]
PadFriction = Annotated[
    float | None, typer.Option(metavar="M", help="Torsional friction of fingertips whose description states none, m.")
]
