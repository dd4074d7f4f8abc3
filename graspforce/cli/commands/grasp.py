"""``graspforce grasp``: find grasps of an object, or check postures of a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.commands.grasp_arguments import (
    Fingers,
    Friction,
    GraspClassName,
    HandName,
    Mass,
    ObjectName,
    PadFriction,
    Seed,
)
from graspforce.cli.commands.output_arguments import AsJson, Force

app = typer.Typer()


@app.command(epilog="Example: graspforce grasp --hand allegro_right --object cylinder:0.025,0.08 --save grasp.json --plots out")
def grasp(
    hand: HandName = "allegro_right",
    object_name: ObjectName = "sphere:0.03",
    mass: Mass = None,
    friction: Friction = None,
    fingers: Fingers = None,
    gravity: Annotated[
        str | None,
        typer.Option(metavar="X,Y,Z", help="Gravity in the hand's base frame, m/s² (default: each of six directions)."),
    ] = None,
    seed: Seed = 0,
    budget: Annotated[
        float | None, typer.Option(metavar="S", help="Time after which the search ends with the best grasp so far.")
    ] = None,
    grasp_class: GraspClassName = None,
    approach: Annotated[
        str | None,
        typer.Option(metavar="X,Y,Z", help="Direction in the object's frame in which the palm faces, to within 30°."),
    ] = None,
    table: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Direction in the object's frame away from a table on which it stands.")
    ] = None,
    pad_friction: PadFriction = None,
    count: Annotated[int, typer.Option(metavar="N", help="Number of different grasps, the best first.")] = 1,
    rank: Annotated[
        str, typer.Option(metavar="MEASURE", help="margin: slip margin. robustness: force closure. clearance: distances.")
    ] = "margin",
    postures: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Take postures from a file instead: .npy of BODex or DexGraspBench, or .csv."),
    ] = None,
    root: Annotated[
        str | None, typer.Option(metavar="LINK", help="Link whose pose the file of postures states (default: the base).")
    ] = None,
    repair: Annotated[
        float, typer.Option(metavar="M", help="Largest distance by which a fingertip of a posture may be off the object, m.")
    ] = 0.005,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="Save the grasp as JSON, for `Grasp.load`.")] = None,
    plots: Annotated[Path | None, typer.Option(metavar="DIR", help="Draw the object, fingers, contacts and forces.")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Find a grasp of an object, and show its contacts and what it bears.

    With --count, several different grasps are listed. The best is shown; the files of the others end in _2, _3 and so on.

    With --postures, fingertips near the object are moved onto it, and postures that do not hold it are listed with the reason.
    The grasp with the largest slip margin is shown.

    The classes power and lateral have contacts on inner links and the palm. `graspforce simulate --class power` controls such a
    grasp; plans and streams need contacts of fingertips.

    Exit code 1: no grasp was found, or no posture of the file holds the object.
    """

    from graspforce.cli import run_grasp
    from graspforce.cli.json_output import result_console
    from graspforce.cli.options import GraspOptions

    options = run_grasp.GraspCommandOptions(
        grasp=GraspOptions(hand, object_name, mass, friction, fingers, gravity or "0,0,-9.81", seed),
        has_gravity=gravity is not None,
        search=run_grasp.parse_search(budget, grasp_class, approach, table, pad_friction),
        count=count,
        rank=rank,
        postures=postures,
        root=root,
        repair=repair,
    )
    raise typer.Exit(0 if run_grasp.run(options, run_grasp.GraspOutput(save, plots, force), result_console(as_json)) else 1)
