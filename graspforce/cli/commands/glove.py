"""``graspforce glove``: calibrate a glove in a guided sequence or from files, and let it lead a hand over streams."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.commands.grasp_arguments import Fingers, Friction, Gravity, HandName, Mass, ObjectName, Seed
from graspforce.cli.commands.output_arguments import (
    AsJson,
    FilmCamera,
    FilmFile,
    FilmRate,
    FilmSize,
    Force,
    McapFile,
    RunFile,
    ViewKind,
)
from graspforce.core.errors import InvalidInput
from graspforce.core.optional_libraries import require_libraries

app = typer.Typer()
glove = typer.Typer(no_args_is_help=True, help="Calibrate a glove, and let it lead a hand.")
app.add_typer(glove, name="glove")


@glove.callback()
def _glove() -> None:
    """Calibrate a glove, so that its sensors give joint positions, and let it lead a hand."""


@glove.command(epilog="Example: graspforce glove postures leap_right postures.csv --count 60")
def postures(
    hand: Annotated[str, typer.Argument(metavar="HAND", help="Hand whose joints the glove measures.")],
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File of the postures, .csv or .parquet.")],
    count: Annotated[int, typer.Option(metavar="N", help="Number of postures.")] = 60,
    seed: Seed = 0,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Write the postures of a calibration: neutral, then random ones within the limits whose links do not touch."""
    from graspforce.cli.output_files import check_new_file
    from graspforce.cli.run_glove import calibration_postures
    from graspforce.hand.hand import Hand

    check_new_file(file, "FILE", force)
    library = calibration_postures(Hand.load(hand), count, seed)
    library.save(file)
    print(json.dumps({"postures": len(library), "file": str(file)}) if as_json else f"Postures: {file}")


@glove.command(
    epilog="Example: graspforce glove calibrate postures.csv frames.csv --save glove.json, "
    "or guided: cat /dev/ttyACM0 | graspforce glove calibrate postures.csv - --guide --save glove.json"
)
def calibrate(
    postures: Annotated[
        Path, typer.Argument(metavar="POSTURES", help="Ten postures at least: .csv or .parquet, a column for each joint, rad.")
    ],
    frames: Annotated[
        str,
        typer.Argument(
            metavar="FRAMES",
            help="Readings, a line for each frame, with equally many frames for each posture. With --guide: a device, or - for "
            "standard input.",
        ),
    ],
    guide: Annotated[
        bool, typer.Option("--guide", help="Show one posture after the other, and read a running glove in each.")
    ] = False,
    per_posture: Annotated[int, typer.Option(metavar="N", help="Frames to average in each posture, with --guide.")] = 30,
    skip: Annotated[
        int, typer.Option(metavar="N", help="Frames before each posture, in which you take it, with --guide.")
    ] = 150,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="File of the calibration, .json.")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Fit joint positions to readings that were recorded in known postures, one posture after the other.

    With --guide, the command names the joints that move to each posture, waits while you take it, and averages the frames.
    """
    import numpy as np

    from graspforce.cli.output_files import check_new_file
    from graspforce.core.text_table import Table
    from graspforce.learning.glove.calibration import calibrate_glove, mean_readings
    from graspforce.learning.posture_library import PostureLibrary

    check_new_file(save, "--save", force)
    library = PostureLibrary.load(postures)
    if guide:
        from graspforce.cli.console import progress_console
        from graspforce.cli.run_glove import guided

        readings = guided(library, frames, per_posture, skip, progress_console())
    else:
        readings = mean_readings(frames, len(library))
    calibration = calibrate_glove(readings, library.joints, library.q)
    if save is not None:
        calibration.save(save)
    if as_json:
        errors = dict(zip(library.joints, calibration.mean_error.tolist(), strict=True))
        print(json.dumps({"method": calibration.method, "mean_error": errors, "file": None if save is None else str(save)}))
        return
    errors_deg = np.degrees(calibration.mean_error).tolist()
    rows = tuple((name, f"{error:.2f}") for name, error in zip(library.joints, errors_deg, strict=True))
    print(Table(("joint", "mean error (°)"), rows, f"Cross-validated, {calibration.method}, {len(library)} postures"))
    if save is not None:
        print(f"Calibration: {save}")


@glove.command(epilog="Example: graspforce glove stream frames.csv glove.json --hand leap_right --gravity 0,0,-9.81 --serve")
def stream(
    frames: Annotated[
        str,
        typer.Argument(
            metavar="FRAMES", help="Readings: a file, or the device or pipe of a running glove; - for standard input."
        ),
    ],
    calibration: Annotated[Path, typer.Argument(metavar="CALIBRATION", help="File of `graspforce glove calibrate`.")],
    hand: HandName = "leap_right",
    model: Annotated[
        str | None, typer.Option(metavar="NAME", help="Hand whose joints the calibration has (default: that of --hand).")
    ] = None,
    pairs: Annotated[
        str | None,
        typer.Option(metavar="FINGER=MODEL_FINGER,…", help="Which finger leads which (default: those of the same name)."),
    ] = None,
    glove_rate: Annotated[float, typer.Option(metavar="HZ", help="Frames per second of a file.")] = 60.0,
    free: Annotated[bool, typer.Option("--free", help="Approach: move the hand without an object.")] = False,
    object_name: ObjectName = "sphere:0.03",
    mass: Mass = None,
    friction: Friction = None,
    fingers: Fingers = None,
    gravity: Gravity = "0,0,-9.81",
    seed: Seed = 0,
    largest_travel: Annotated[
        float, typer.Option(metavar="M", help="Largest displacement of the object, m; less if its grasp allows less.")
    ] = 0.005,
    gain: Annotated[float, typer.Option(metavar="X", help="Object displacement over that of the fingertips.")] = 1.0,
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="Simulated time, s (default: that of the file, or 10).")
    ] = None,
    connect: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="Run the controller in the service at this Zenoh endpoint.")
    ] = None,
    serve: Annotated[bool, typer.Option("--serve", help="Start a service, and run the controller in it.")] = False,
    view: ViewKind = None,
    video: FilmFile = None,
    film_size: FilmSize = None,
    fps: FilmRate = None,
    film_camera: FilmCamera = None,
    save: RunFile = None,
    record: McapFile = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Let a glove lead a simulated hand: the object that it holds, or with --free the hand alone.

    The frames give the desired motion of a control stream, at their own rate. The controller chooses and certifies the forces.
    A running glove leads the simulation in real time.

    Exit code 1: a finger lost contact or slipped.
    """
    require_libraries("mujoco")

    from graspforce.cli import run_glove
    from graspforce.cli.film_format import parse_film_format
    from graspforce.cli.json_output import result_console
    from graspforce.cli.options import GraspOptions, parse_vector
    from graspforce.cli.run_simulation import SimulateOutput, service_options
    from graspforce.cli.simulate_options import SimulateOptions
    from graspforce.core.arrays import freeze
    from graspforce.hand.hand import Hand

    options = run_glove.GloveOptions(frames, calibration, model, pairs, glove_rate, largest_travel, gain)
    service, time = service_options(connect, serve), run_glove.stream_duration(options, duration)
    console = result_console(as_json)
    if free:
        if any(each is not None for each in (view, video, save, record)):
            raise InvalidInput("--free", free, "given without --view, --video, --save and --record")
        run_glove.approach(options, Hand.load(hand), time, freeze(parse_vector(gravity, "gravity")), console, service)
        return
    simulation = SimulateOptions(
        grasp=GraspOptions(hand, object_name, mass, friction, fingers, gravity, seed),
        reference="still", travel=(0.0, 0.0, 0.0), period=1.0, duration=time, pushes=(),
    )  # fmt: skip
    output = SimulateOutput(
        view=view, video=video, frames=None, save=save, plots=None, record=record, force=force,
        film=parse_film_format(film_size, fps, film_camera),
    )  # fmt: skip
    raise typer.Exit(0 if run_glove.hold(options, simulation, output, console, service) else 1)
