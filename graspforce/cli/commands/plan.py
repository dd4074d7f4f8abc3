"""``graspforce plan`` and ``graspforce simulate``: plan and simulate motions of a held object."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.console import print_error
from graspforce.core.errors import InvalidInput

app = typer.Typer()

# Options of both commands.
ObjectName = Annotated[
    str,
    typer.Option(
        "--object", metavar="OBJECT", help="sphere:RADIUS, cylinder:RADIUS,HEIGHT or box:X,Y,Z (m), or a name: pen, …"
    ),
]
Mass = Annotated[float | None, typer.Option(metavar="KG", help="Mass, kg (default: 0.05, or that of the named object).")]
Friction = Annotated[
    float | None, typer.Option(metavar="MU", help="Friction coefficient (default: 0.7, or that of the named object).")
]
Fingers = Annotated[str | None, typer.Option(metavar="A,B,C", help="Fingers to use (default: chosen automatically).")]
Gravity = Annotated[str, typer.Option(metavar="X,Y,Z", help="Gravity in the hand's base frame, m/s².")]
Seed = Annotated[int, typer.Option(metavar="N", help="Random seed for the grasp search.")]
HandName = Annotated[str, typer.Option(metavar="NAME", help="Name of a hand (see `graspforce hands`), or a description file.")]


@app.command(epilog="Example: graspforce plan --hand dlr_hit2 --to=-0.005,0,0.005 --turn 0.1,0,0.1 --plots out --execute")
def plan(
    hand: HandName = "allegro_right",
    object_name: ObjectName = "sphere:0.03",
    to: Annotated[
        str, typer.Option(metavar="DX,DY,DZ", help="Translation of the object in the hand's base frame, m.")
    ] = "0,0,0",
    turn: Annotated[str, typer.Option(metavar="RX,RY,RZ", help="Rotation of the object: rotation vector, rad.")] = "0,0,0",
    method: Annotated[
        str, typer.Option(metavar="NAME", help="path: along a straight line. free: optimise the path too.")
    ] = "path",
    mass: Mass = None,
    friction: Friction = None,
    fingers: Fingers = None,
    gravity: Gravity = "0,0,-9.81",
    intervals: Annotated[
        int | None, typer.Option(metavar="N", help="Number of intervals (default: 100; 40 for the free method).")
    ] = None,
    budget: Annotated[float, typer.Option(metavar="SECONDS", help="Planning time; then the best plan so far is used.")] = 30.0,
    connect: Annotated[str | None, typer.Option(metavar="ENDPOINT", help="Plan in the service at this Zenoh endpoint.")] = None,
    margin: Annotated[float, typer.Option(metavar="N", help="Slip margin of every contact, N.")] = 1.0,
    reserve: Annotated[float, typer.Option(metavar="PART", help="Fraction of motor torque reserved for feedback.")] = 0.1,
    seed: Seed = 0,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="Save the plan: .json, .npz or .csv.")] = None,
    plots: Annotated[Path | None, typer.Option(metavar="DIR", help="Plot speed, active limits, torques and forces.")] = None,
    execute: Annotated[bool, typer.Option("--execute", help="Execute the plan in MuJoCo with the controller.")] = False,
) -> None:
    """Plan the fastest move of a held object, and show which limits are active when.

    Give --to, --turn, or both. Every plan is checked between its knots.

    Ctrl-C stops the search and uses the best plan so far; a second Ctrl-C ends the command.

    Exit code 0: a plan was found, and executed without slip if --execute was given. 2: the move is infeasible. 1: an error, no
    verdict, or an executed move that slipped or missed its goal.
    """
    if execute and importlib.util.find_spec("mujoco") is None:
        raise typer.Exit(print_error('--execute needs MuJoCo: run pip install --editable ".[sim]" in the checkout'))
    from rich.console import Console

    from graspforce.cli import run_plan
    from graspforce.cli.options import GraspOptions, parse_vector

    options = run_plan.PlanOptions(
        grasp=GraspOptions(hand, object_name, mass, friction, fingers, gravity, seed),
        to=parse_vector(to, "to"),
        turn=parse_vector(turn, "turn"),
        method=method,
        intervals=intervals,
        budget=budget,
        slip_margin=margin,
        reserve=reserve,
    )
    output = run_plan.PlanOutput(save=save, plots=plots, execute=execute)
    raise typer.Exit(run_plan.run(options, output, Console(highlight=False), connect))


@app.command(epilog="Example: graspforce simulate --hand four_finger --reference turn --travel 0,0,0.2 --video turn.mp4")
def simulate(
    hand: HandName = "four_finger",
    object_name: ObjectName = "sphere:0.03",
    mass: Mass = None,
    friction: Friction = None,
    fingers: Fingers = None,
    gravity: Gravity = "0,0,-9.81",
    reference: Annotated[
        str, typer.Option(metavar="KIND", help="Reference motion: still, reach (out and back), sine or turn.")
    ] = "reach",
    travel: Annotated[
        str, typer.Option(metavar="X,Y,Z", help="Travel from end to end, m; for turn a rotation vector, rad.")
    ] = "0,0,0.01",
    period: Annotated[float, typer.Option(metavar="S", help="Period of the reference motion, s.")] = 1.0,
    turn: Annotated[str, typer.Option(metavar="RX,RY,RZ", help="Rotate out and back as well: rotation vector, rad.")] = "0,0,0",
    turn_period: Annotated[float | None, typer.Option(metavar="S", help="Period of --turn, s (default: --period).")] = None,
    duration: Annotated[float, typer.Option(metavar="S", help="Simulated time, s.")] = 2.0,
    push: Annotated[
        list[str] | None,
        typer.Option(metavar="FX,FY,FZ,START,DURATION", help="Force on the object, N, with start and duration, s; repeatable."),
    ] = None,
    seed: Seed = 0,
    connect: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="Run the controller in the service at this Zenoh endpoint.")
    ] = None,
    serve: Annotated[bool, typer.Option("--serve", help="Start a service, and run the controller in it.")] = False,
    pace: Annotated[
        str, typer.Option(metavar="KIND", help="Time with a service: lockstep waits for each command; real runs by the clock.")
    ] = "lockstep",
    tips: Annotated[
        str, typer.Option(metavar="KIND", help="Fingertip geometry: ball, or mesh (convex hull of the hand's mesh).")
    ] = "ball",
    meshes: Annotated[
        list[Path] | None, typer.Option(metavar="DIR", help="Directory with the hand's meshes; repeatable.")
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Open MuJoCo's viewer (needs a display).")] = False,
    video: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a film: .mp4, .gif or .webp (needs no display).")
    ] = None,
    frames: Annotated[Path | None, typer.Option(metavar="DIR", help="Write the frames of the film as PNG.")] = None,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="Save the recording of all steps as .npz.")] = None,
    plots: Annotated[Path | None, typer.Option(metavar="DIR", help="Write plots of errors, forces and torques as PNG.")] = None,
) -> None:
    """Hold and move an object in MuJoCo, in closed loop at 1 kHz. Exit code 1: a finger lost contact or slipped."""
    if importlib.util.find_spec("mujoco") is None:
        raise typer.Exit(print_error('simulate needs MuJoCo: run pip install --editable ".[sim]" in the checkout'))
    from rich.console import Console

    from graspforce.cli import run_simulation
    from graspforce.cli.options import GraspOptions, parse_vector

    options = run_simulation.SimulateOptions(
        grasp=GraspOptions(hand, object_name, mass, friction, fingers, gravity, seed),
        reference=reference,
        travel=parse_vector(travel, "travel"),
        period=period,
        duration=duration,
        pushes=tuple(parse_vector(text, "push", 5) for text in push or []),
        tips=tips,
        meshes=tuple(meshes or ()),
        turn=parse_vector(turn, "turn"),
        turn_period=turn_period,
    )
    output = run_simulation.SimulateOutput(view=view, video=video, frames=frames, save=save, plots=plots)
    if serve and connect is not None:
        raise InvalidInput("--connect", connect, "given without --serve, which starts its own service")
    if pace == "real" and not serve and connect is None:
        raise InvalidInput("--pace", pace, "given with --serve or --connect only")
    service = run_simulation.ServiceOptions(connect, pace) if serve or connect is not None else None
    raise typer.Exit(0 if run_simulation.run(options, output, Console(highlight=False), service) else 1)
