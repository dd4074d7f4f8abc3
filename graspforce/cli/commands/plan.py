"""``graspforce plan`` and ``graspforce simulate``: a held object moves, as fast as it can or in closed loop."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.console import print_error
from graspforce.core.errors import InvalidInput

app = typer.Typer()

# What both ask.
ObjectName = Annotated[
    str,
    typer.Option("--object", metavar="THING", help="sphere:RADIUS, cylinder:RADIUS,HEIGHT, box:X,Y,Z (m), or a name: pen, …"),
]
Mass = Annotated[float | None, typer.Option(metavar="KG", help="By default 0.05, or the named object's own.")]
Friction = Annotated[float | None, typer.Option(metavar="MU", help="By default 0.7, or the named object's own.")]
Fingers = Annotated[str | None, typer.Option(metavar="A,B,C", help="Which touch; by default the best few.")]
Gravity = Annotated[str, typer.Option(metavar="X,Y,Z", help="In the hand's base frame, m/s².")]
Seed = Annotated[int, typer.Option(metavar="N", help="Of the search for a hold.")]
HandName = Annotated[str, typer.Option(metavar="NAME", help="A hand of `graspforce hands`, or a description file.")]


@app.command(epilog="Example: graspforce plan --hand dlr_hit2 --to=-0.005,0,0.005 --turn 0.1,0,0.1 --plots out --execute")
def plan(
    hand: HandName = "allegro_right",
    object_name: ObjectName = "sphere:0.03",
    to: Annotated[str, typer.Option(metavar="DX,DY,DZ", help="How far the object goes, in the hand's base, m.")] = "0,0,0",
    turn: Annotated[str, typer.Option(metavar="RX,RY,RZ", help="How it turns: rotation vector, rad.")] = "0,0,0",
    method: Annotated[str, typer.Option(metavar="NAME", help="path: the straight line. free: any way.")] = "path",
    mass: Mass = None,
    friction: Friction = None,
    fingers: Fingers = None,
    gravity: Gravity = "0,0,-9.81",
    intervals: Annotated[int | None, typer.Option(metavar="N", help="Between knots; by default 100, free 40.")] = None,
    budget: Annotated[float, typer.Option(metavar="SECONDS", help="For planning; then the best plan so far is taken.")] = 30.0,
    connect: Annotated[str | None, typer.Option(metavar="ENDPOINT", help="Plan in the service at this endpoint.")] = None,
    margin: Annotated[float, typer.Option(metavar="N", help="Friction kept back at every contact, N.")] = 1.0,
    reserve: Annotated[float, typer.Option(metavar="PART", help="Of motor torque, left to the controller.")] = 0.1,
    seed: Seed = 0,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the plan: .json, .csv or .npz.")] = None,
    plots: Annotated[Path | None, typer.Option(metavar="DIR", help="Draw speed and limits, torques, forces in cones.")] = None,
    execute: Annotated[bool, typer.Option("--execute", help="Follow it in MuJoCo, under the controller.")] = False,
) -> None:
    """Plan the fastest move of a held object, checked between its knots, and say what limits it where.

    --to and --turn say where it goes; one of them may be left out.

    Ctrl-C stops the search and takes the best plan so far; a second one ends the command.

    Exit code 0: a plan (executed: the object arrived and nothing slipped). 2: a reason why there is none. 1: an error, no
    answer of either kind, or an executed move that slipped or missed its goal.
    """
    if execute and importlib.util.find_spec("mujoco") is None:
        raise typer.Exit(print_error("the simulation needs MuJoCo: pip install 'graspforce[sim]'"))
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
    reference: Annotated[str, typer.Option(metavar="KIND", help="still, reach (out and back), sine or turn.")] = "reach",
    travel: Annotated[str, typer.Option(metavar="X,Y,Z", help="End to end, m; a turn: rotation vector, rad.")] = "0,0,0.01",
    period: Annotated[float, typer.Option(metavar="S", help="Of the motion.")] = 1.0,
    turn: Annotated[str, typer.Option(metavar="RX,RY,RZ", help="Rotate out and back as well: rotation vector, rad.")] = "0,0,0",
    turn_period: Annotated[float | None, typer.Option(metavar="S", help="Of --turn; by default --period.")] = None,
    duration: Annotated[float, typer.Option(metavar="S", help="How long to simulate.")] = 2.0,
    push: Annotated[
        list[str] | None, typer.Option(metavar="FX,FY,FZ,START,DURATION", help="N and s; may be given again.")
    ] = None,
    seed: Seed = 0,
    connect: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="Control from the service at this Zenoh endpoint.")
    ] = None,
    serve: Annotated[bool, typer.Option("--serve", help="Control from a service that is started for this.")] = False,
    pace: Annotated[
        str, typer.Option(metavar="KIND", help="With a service: lockstep (wait for each command) or real (1 kHz by the clock).")
    ] = "lockstep",
    tips: Annotated[
        str, typer.Option(metavar="KIND", help="ball, as the controller has it, or mesh: the hull of the hand's own.")
    ] = "ball",
    meshes: Annotated[
        list[Path] | None, typer.Option(metavar="DIR", help="Where the hand's meshes are looked for; may be given again.")
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Open MuJoCo's viewer; needs a display.")] = False,
    video: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a film: .mp4, .webp or .gif; needs no display.")
    ] = None,
    frames: Annotated[Path | None, typer.Option(metavar="DIR", help="Write the film's frames as PNG files.")] = None,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the recording of all steps as .npz.")] = None,
    plots: Annotated[Path | None, typer.Option(metavar="DIR", help="Plot errors, forces and torques as PNG files.")] = None,
) -> None:
    """Hold an object in MuJoCo and move it, in closed loop at 1 kHz. Exit code 1: a finger lost contact or slipped."""
    if importlib.util.find_spec("mujoco") is None:
        raise typer.Exit(print_error("the simulation needs MuJoCo: pip install 'graspforce[sim]'"))
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
        raise InvalidInput("--connect", connect, "left out with --serve, which starts a service of its own")
    if pace == "real" and not serve and connect is None:
        raise InvalidInput("--pace", pace, "left out without a service, which --serve starts and --connect finds")
    service = run_simulation.ServiceOptions(connect, pace) if serve or connect is not None else None
    raise typer.Exit(0 if run_simulation.run(options, output, Console(highlight=False), service) else 1)
