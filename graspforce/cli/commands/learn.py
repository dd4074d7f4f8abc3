"""``graspforce learn``: libraries of recorded postures, their synergies, and the motions of fingers in recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.commands.output_arguments import AsJson, FilmCamera, FilmFile, FilmFrames, FilmRate, FilmSize, Force
from graspforce.cli.commands.recording_arguments import HandsInPlace
from graspforce.cli.completions import complete_hand
from graspforce.core.optional_libraries import require_libraries

app = typer.Typer()
learn = typer.Typer(no_args_is_help=True, help="Learn from recorded postures and motions.")
app.add_typer(learn, name="learn")


@learn.callback()
def _learn() -> None:
    """Learn from recorded postures and motions."""


@learn.command(epilog="Example: graspforce learn collect day.mcap postures.csv --every 0.5")
def collect(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="Recording of `graspforce simulate` (.npz) or `graspforce serve` (.mcap), or frames of a glove.",
        ),
    ],
    target: Annotated[Path, typer.Argument(metavar="TARGET", help="File of the library, .csv or .parquet.")],
    every: Annotated[float, typer.Option(metavar="S", help="Least time between two postures, s.")] = 0.1,
    calibration: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Calibration of the glove whose frames FILE has.")
    ] = None,
    glove_rate: Annotated[float, typer.Option(metavar="HZ", help="Frames per second of a file.")] = 60.0,
    hand: HandsInPlace = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Collect a library of postures from a recording. Postures that repeat the one before are left out."""
    require_libraries("mujoco")
    if file.suffix == ".mcap":
        require_libraries("mcap", "zenoh")
    from graspforce.cli.json_output import result_console
    from graspforce.cli.output_files import check_new_file
    from graspforce.cli.run_collect import from_glove, from_recording, save
    from graspforce.core import arrays

    check_new_file(target, "TARGET", force)
    arrays.check_number(every, "--every", above=0.0)
    arrays.check_number(glove_rate, "--glove-rate", above=0.0)
    if calibration is None:
        library = from_recording(file, hand or (), every)
    else:
        library = from_glove(file, calibration, glove_rate, every)
    save(library, target, result_console(as_json))


@learn.command(epilog="Example: graspforce learn synergies postures.csv --hand leap_right --video synergies.webp")
def synergies(
    postures: Annotated[
        Path, typer.Argument(metavar="POSTURES", help="Library of postures: .csv or .parquet, a column for each joint, rad.")
    ],
    hand: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Hand of the postures, for --video, --frames and --plots.",
            autocompletion=complete_hand,
        ),
    ] = None,
    components: Annotated[int, typer.Option(metavar="N", help="Components in the film and the plots.")] = 2,
    span: Annotated[float, typer.Option(metavar="X", help="Amplitude of the film, standard deviations.")] = 2.0,
    duration: Annotated[float, typer.Option(metavar="S", help="Time of each component in the film, s.")] = 4.0,
    video: FilmFile = None,
    frames: FilmFrames = None,
    film_size: FilmSize = None,
    fps: FilmRate = None,
    film_camera: FilmCamera = None,
    plots: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write plots of variance, errors, postures and object sizes as PNG.")
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Show the principal components of postures, and how much of the variance they explain.

    The film moves the hand along one component after the other.
    """
    require_libraries("sklearn")
    if video is not None or frames is not None:
        require_libraries("mujoco")
    from graspforce.cli.film_format import parse_film_format
    from graspforce.cli.json_output import result_console
    from graspforce.cli.options import RunFiles
    from graspforce.cli.run_synergies import SynergiesOptions, run

    files = RunFiles(video, frames, plots, force, parse_film_format(film_size, fps, film_camera))
    run(SynergiesOptions(postures, hand, components, span, duration, files), result_console(as_json))


@learn.command(epilog="Example: graspforce learn label day.mcap --record labelled.mcap")
def label(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Recording of `graspforce simulate` (.npz) or `graspforce serve` (.mcap).")
    ],
    hand: HandsInPlace = None,
    deadband: Annotated[
        float, typer.Option(metavar="DEG", help="Largest change of an angle in 10 ms that counts as rest, degrees.")
    ] = 0.03,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="Save the labels as .csv.")] = None,
    record: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Save a copy of an .mcap recording with a topic of labels.")
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Label the motions of the fingers in a recording: what each finger does, from when to when.

    Motions 1 to 4 open a finger, 5 to 8 close it, and 9 is rest.
    """
    require_libraries("mujoco")
    if file.suffix == ".mcap":
        require_libraries("mcap", "zenoh")
    from graspforce.cli.json_output import result_console
    from graspforce.cli.run_label import LabelOptions, run

    run(LabelOptions(file, tuple(hand or ()), deadband, save, record, force), result_console(as_json))


@learn.command(epilog="Example: graspforce learn similar turn.npz runs/*.npz")
def similar(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording of `graspforce simulate`, .npz.")],
    others: Annotated[list[Path], typer.Argument(metavar="FILES", help="Recordings to compare with.")],
    deadband: Annotated[
        float, typer.Option(metavar="DEG", help="Largest change of an angle in 10 ms that counts as rest, degrees.")
    ] = 0.03,
    count: Annotated[int, typer.Option(metavar="N", help="Recordings to show at most.")] = 5,
    as_json: AsJson = False,
) -> None:
    """Find recordings like another one, by the order in which the fingers move."""
    require_libraries("mujoco")
    from graspforce.cli.json_output import result_console
    from graspforce.cli.run_label import run_similar

    run_similar(file, others, deadband, count, result_console(as_json))
