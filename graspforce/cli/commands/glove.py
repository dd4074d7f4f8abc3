"""``graspforce glove``: calibrate a glove from frames recorded in known postures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.commands.output_arguments import AsJson, Force

app = typer.Typer()
glove = typer.Typer(no_args_is_help=True, help="Calibrate a glove, so that its sensors give joint positions.")
app.add_typer(glove, name="glove")


@glove.callback()
def _glove() -> None:
    """Calibrate a glove, so that its sensors give joint positions."""


@glove.command(epilog="Example: graspforce glove calibrate postures.csv frames.csv --save glove.json")
def calibrate(
    postures: Annotated[
        Path, typer.Argument(metavar="POSTURES", help="Ten postures at least: .csv or .parquet, a column for each joint, rad.")
    ],
    frames: Annotated[
        Path,
        typer.Argument(metavar="FRAMES", help="Readings, a line for each frame, with equally many frames for each posture."),
    ],
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="File of the calibration, .json.")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Fit joint positions to readings that were recorded in known postures, one posture after the other."""
    import numpy as np

    from graspforce.cli.output_files import check_new_file
    from graspforce.core.text_table import Table
    from graspforce.learning.glove.calibration import calibrate_glove, mean_readings
    from graspforce.learning.posture_library import PostureLibrary

    check_new_file(save, "--save", force)
    library = PostureLibrary.load(postures)
    calibration = calibrate_glove(mean_readings(frames, len(library)), library.joints, library.q)
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
