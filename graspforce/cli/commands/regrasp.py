"""``graspforce regrasp``: turn a held object beyond the reach of one grasp, with fingers that step, in simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.commands.grasp_arguments import Fingers, Friction, Gravity, HandName, Mass, ObjectName, Seed
from graspforce.cli.commands.output_arguments import AsJson, FilmCamera, FilmFile, FilmFrames, FilmRate, FilmSize, Force
from graspforce.core.optional_libraries import require_libraries

app = typer.Typer()


@app.command(epilog="Example: graspforce regrasp --hand four_finger --object sphere:0.03 --axis 0,0,1 --angle 1.57 --plots out")
def regrasp(
    hand: HandName = "four_finger",
    object_name: ObjectName = "sphere:0.03",
    mass: Mass = None,
    friction: Friction = 0.8,
    fingers: Fingers = None,
    gravity: Gravity = "0,0,-9.81",
    seed: Seed = 0,
    axis: Annotated[str, typer.Option(metavar="X,Y,Z", help="Axis of the turn in the hand's base frame.")] = "0,0,1",
    angle: Annotated[float, typer.Option(metavar="RAD", help="Angle of the turn, rad; 6.283 for a whole turn.")] = 1.57,
    object_axis: Annotated[
        str, typer.Option(metavar="X,Y,Z", help="Direction of the object's z axis at the start, in the hand's base frame.")
    ] = "0,0,1",
    to: Annotated[
        str | None, typer.Option(metavar="DX,DY,DZ", help="Bring the object to this displacement, m, on any path found.")
    ] = None,
    turn: Annotated[
        str | None, typer.Option(metavar="RX,RY,RZ", help="And to this rotation vector in the base frame, rad, on any path.")
    ] = None,
    friction_error: Annotated[
        float,
        typer.Option(
            "--friction-uncertainty",
            metavar="PART",
            help="Part by which the friction may be less; forces hold for all of the interval.",
        ),
    ] = 0.0,
    slip_margin: Annotated[float, typer.Option(metavar="N", help="Slip margin that the forces keep, N.")] = 0.3,
    budget: Annotated[float, typer.Option(metavar="S", help="Time after which the search ends, s.")] = 120.0,
    video: FilmFile = None,
    frames: FilmFrames = None,
    film_size: FilmSize = None,
    fps: FilmRate = None,
    film_camera: FilmCamera = None,
    plots: Annotated[Path | None, typer.Option(metavar="DIR", help="Write plots of margins, errors, torques as PNG.")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Turn a held object with finger steps: one finger lets go, moves and joins again while the others hold.

    With --to or --turn, the object goes to a pose, on whichever path the search finds: straight, position and orientation one
    after the other, or the longer way round.

    The search draws places at random: another --seed or a longer --budget may find a plan where one search found none.

    Exit code 1: no plan was found, or the object did not reach its goal.
    """
    require_libraries("mujoco")

    from graspforce.cli import run_regrasp
    from graspforce.cli.film_format import parse_film_format
    from graspforce.cli.json_output import result_console
    from graspforce.cli.options import GraspOptions, RunFiles, parse_vector

    options = run_regrasp.RegraspOptions(
        grasp=GraspOptions(hand, object_name, mass, friction, fingers, gravity, seed),
        axis_H=parse_vector(axis, "--axis"),
        angle=angle,
        object_axis_H=parse_vector(object_axis, "--object-axis"),
        slip_margin=slip_margin,
        budget=budget,
        to=None if to is None and turn is None else parse_vector(to or "0,0,0", "--to"),
        turn=parse_vector(turn or "0,0,0", "--turn"),
        friction_error=friction_error,
    )
    output = RunFiles(video, frames, plots, force, parse_film_format(film_size, fps, film_camera))
    raise typer.Exit(0 if run_regrasp.run(options, output, result_console(as_json)) else 1)
