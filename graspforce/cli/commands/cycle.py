"""``graspforce cycle``: pick an object from a table, move it, place it and let it go, in simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.commands.grasp_arguments import Fingers, Friction, HandName, Mass, ObjectName, Seed
from graspforce.cli.commands.output_arguments import AsJson, FilmCamera, FilmFile, FilmFrames, FilmRate, FilmSize, Force
from graspforce.core.optional_libraries import require_libraries

app = typer.Typer()


@app.command(epilog="Example: graspforce cycle --hand dlr_hit2 --object cylinder:0.025,0.08 --world real --video cycle.webp")
def cycle(
    hand: HandName = "dlr_hit2",
    object_name: ObjectName = "cylinder:0.025,0.08",
    mass: Mass = None,
    friction: Friction = None,
    fingers: Fingers = None,
    seed: Seed = 0,
    lift: Annotated[float, typer.Option(metavar="M", help="Height of the lift, m.")] = 0.05,
    move: Annotated[str, typer.Option(metavar="X,Y", help="Displacement along the table, m.")] = "0.05,0",
    pose_error: Annotated[
        str,
        typer.Option(metavar="M,RAD", help="Largest error of the object's expected place, m, and of its rotation, rad."),
    ] = "0.01,0.175",
    world: Annotated[
        str, typer.Option(metavar="KIND", help="nominal: as told. real: random deviations of everything.")
    ] = "nominal",
    world_seed: Annotated[int, typer.Option(metavar="N", help="Seed of the world and of the pose error.")] = 0,
    controller: Annotated[
        str, typer.Option(metavar="KIND", help="estimate: from measurements. exact: full knowledge, for comparison.")
    ] = "estimate",
    standoff: Annotated[
        float, typer.Option(metavar="M", help="Distance of the fingertips from the contacts before the close, m.")
    ] = 0.02,
    touch_force: Annotated[float, typer.Option(metavar="N", help="Largest force of a fingertip before the squeeze, N.")] = 0.2,
    minimum_time: Annotated[
        bool, typer.Option("--minimum-time", help="Plan the fastest approach, lift, move and place within the limits below.")
    ] = False,
    base_speed: Annotated[float, typer.Option(metavar="M/S", help="Largest speed of the hand's base.")] = 0.5,
    base_acceleration: Annotated[float, typer.Option(metavar="M/S²", help="Largest acceleration of the hand's base.")] = 3.0,
    base_jerk: Annotated[float, typer.Option(metavar="M/S³", help="Largest jerk of the hand's base.")] = 60.0,
    joint_jerk: Annotated[float, typer.Option(metavar="RAD/S³", help="Largest jerk of each joint in the approach.")] = 2000.0,
    reserve: Annotated[float, typer.Option(metavar="PART", help="Fraction of motor torque reserved for feedback.")] = 0.1,
    connect: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="Run the controller in the service at this Zenoh endpoint.")
    ] = None,
    serve: Annotated[bool, typer.Option("--serve", help="Start a service, and run the controller in it.")] = False,
    video: FilmFile = None,
    frames: FilmFrames = None,
    film_size: FilmSize = None,
    fps: FilmRate = None,
    film_camera: FilmCamera = None,
    plots: Annotated[Path | None, typer.Option(metavar="DIR", help="Write plots of forces, loads and torques as PNG.")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Simulate a grasp cycle: approach, close, squeeze, lift, move, place, release, retract.

    The object stands on a table, up to 10 mm and 10° from where the controller expects it. The hand's base is moved by an
    ideal arm.

    With --minimum-time the durations of approach, lift, move and place are optimised within torques, forces and joint rates.

    Exit code 1: the object was not lifted, moved, placed and released.
    """
    require_libraries("mujoco")

    from graspforce.cli import run_cycle
    from graspforce.cli.film_format import parse_film_format
    from graspforce.cli.json_output import result_console
    from graspforce.cli.options import GraspOptions, RunFiles, parse_vector
    from graspforce.cli.run_simulation import service_options

    limits = (base_speed, base_acceleration, base_jerk, joint_jerk, reserve)
    error = parse_vector(pose_error, "--pose-error", 2)
    options = run_cycle.CycleOptions(
        grasp=GraspOptions(hand, object_name, mass, friction, fingers, "0,0,-9.81", seed),
        lift=lift,
        move=parse_vector(move, "--move", 2),
        pose_error=(error[0], error[1]),
        world=world,
        world_seed=world_seed,
        controller=controller,
        standoff=standoff,
        touch_force=touch_force,
        limits=run_cycle.parse_cycle_limits(*limits) if minimum_time else None,
    )
    output = RunFiles(video, frames, plots, force, parse_film_format(film_size, fps, film_camera))
    service = service_options(connect, serve)
    raise typer.Exit(0 if run_cycle.run(options, output, result_console(as_json), service) else 1)
