"""``graspforce plan``: plan motions of a held object."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.commands.grasp_arguments import Fingers, Friction, Gravity, HandName, Mass, ObjectName, Seed
from graspforce.cli.commands.output_arguments import AsJson, FilmCamera, FilmFrames, FilmRate, FilmSize, Force
from graspforce.core.optional_libraries import require_libraries

app = typer.Typer()


@app.command(epilog="Example: graspforce plan --hand dlr_hit2 --to=-0.005,0,0.005 --turn 0.1,0,0.1 --plots out --execute")
def plan(
    hand: HandName = "allegro_right",
    object_name: ObjectName = "sphere:0.03",
    to: Annotated[
        str, typer.Option(metavar="DX,DY,DZ", help="Translation of the object in the hand's base frame, m.")
    ] = "0,0,0",
    turn: Annotated[str, typer.Option(metavar="RX,RY,RZ", help="Rotation of the object: rotation vector, rad.")] = "0,0,0",
    via: Annotated[
        list[str] | None,
        typer.Option(
            metavar="DX,DY,DZ[,RX,RY,RZ]",
            help="Pose to pass without a stop, from the start as --to and --turn; repeatable, in order.",
        ),
    ] = None,
    method: Annotated[
        str,
        typer.Option(metavar="NAME", help="path: along a straight line, or a spline with --via. free: optimise the path too."),
    ] = "path",
    mass: Mass = None,
    friction: Friction = None,
    fingers: Fingers = None,
    gravity: Gravity = "0,0,-9.81",
    intervals: Annotated[
        int | None, typer.Option(metavar="N", help="Number of intervals (default: 100; 40 for the free method).")
    ] = None,
    budget: Annotated[float, typer.Option(metavar="S", help="Planning time; then the best plan so far is used.")] = 30.0,
    connect: Annotated[str | None, typer.Option(metavar="ENDPOINT", help="Plan in the service at this Zenoh endpoint.")] = None,
    margin: Annotated[float, typer.Option("--slip-margin", metavar="N", help="Slip margin of every contact, N.")] = 1.0,
    reserve: Annotated[float, typer.Option(metavar="PART", help="Fraction of motor torque reserved for feedback.")] = 0.1,
    acceleration: Annotated[
        str | None, typer.Option(metavar="LINEAR[,ANGULAR]", help="Limits of the object's accelerations, m/s² and rad/s².")
    ] = None,
    joint_acceleration: Annotated[
        float | None, typer.Option(metavar="RAD/S²", help="Limit of each joint's acceleration.")
    ] = None,
    jerk: Annotated[
        str | None,
        typer.Option(metavar="LINEAR[,ANGULAR]", help="Limits of the object's jerk, m/s³ and rad/s³."),
    ] = None,
    joint_jerk: Annotated[float | None, typer.Option(metavar="RAD/S³", help="Limit of each joint's jerk.")] = None,
    clearance: Annotated[
        float,
        typer.Option(
            metavar="M", help="Least distance of links, object and obstacles, and of fingertips with --fingertips, m."
        ),
    ] = 0.0,
    obstacle: Annotated[
        list[str] | None,
        typer.Option(metavar="SHAPE@X,Y,Z[,RX,RY,RZ]", help="Sphere, cylinder or box at rest, as --object, m; repeatable."),
    ] = None,
    table: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Direction in the object's frame away from a table on which it stands.")
    ] = None,
    tips: Annotated[
        list[str] | None,
        typer.Option(
            "--fingertips",
            metavar="FINGER=X,Y,Z[;…]",
            help="Move fingertips alone to this place in the base frame, m; repeatable, in order.",
        ),
    ] = None,
    seed: Seed = 0,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="Save the plan: .json, .npz or .csv.")] = None,
    plots: Annotated[Path | None, typer.Option(metavar="DIR", help="Plot speed, active limits, torques and forces.")] = None,
    execute: Annotated[bool, typer.Option("--execute", help="Execute the plan in MuJoCo with the controller.")] = False,
    video: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a film of the execution: .mp4, .gif or .webp (needs no display).")
    ] = None,
    frames: FilmFrames = None,
    view: Annotated[
        str | None, typer.Option(metavar="KIND", help="Show the plan until Ctrl-C: browser (a web page with a timeline).")
    ] = None,
    film_size: FilmSize = None,
    fps: FilmRate = None,
    film_camera: FilmCamera = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Plan the fastest move of a held object, and show which limits are active when.

    Give --to, --turn, or both; --via alone returns to the start. Every plan is checked between its knots.

    With --fingertips, fingers move without an object from the neutral posture; several places are passed without a stop.

    Ctrl-C stops the search and uses the best plan so far; a second Ctrl-C ends the command.

    Exit code 0: a plan was found, and executed without slip if --execute was given. 3: the move is infeasible. 1: an error, no
    verdict, or an executed move that slipped or missed its goal.
    """
    simulated = ("mujoco",) if execute or view is not None else ()
    require_libraries(*simulated, *(("viser",) if view is not None else ()), "casadi")

    from graspforce.cli import run_plan
    from graspforce.cli.film_format import parse_film_format
    from graspforce.cli.json_output import result_console
    from graspforce.cli.options import GraspOptions, parse_vector
    from graspforce.cli.run_finger_plan import FingerPlanOptions, parse_tips

    film = parse_film_format(film_size, fps, film_camera)
    files = {"save": save, "plots": plots, "video": video, "frames": frames}
    output = run_plan.PlanOutput(**files, execute=execute, force=force, film=film, view=view)
    limits, obstacles = run_plan.parse_limits(acceleration, joint_acceleration, jerk, joint_jerk), tuple(obstacle or [])
    if tips:
        places = tuple(parse_tips(text) for text in tips)
        fingers_only = FingerPlanOptions(hand, places, gravity, clearance, obstacles, intervals, limits)
        raise typer.Exit(run_plan.run_fingers(fingers_only, output, budget, result_console(as_json), connect))
    options = run_plan.PlanOptions(
        grasp=GraspOptions(hand, object_name, mass, friction, fingers, gravity, seed),
        to=parse_vector(to, "to"),
        turn=parse_vector(turn, "turn"),
        method=method,
        intervals=intervals,
        budget=budget,
        slip_margin=margin,
        reserve=reserve,
        via=tuple(run_plan.parse_via(text) for text in via or []),
        limits=limits,
        clearance=clearance,
        obstacles=obstacles,
        table=table,
    )
    raise typer.Exit(run_plan.run(options, output, result_console(as_json), connect))
