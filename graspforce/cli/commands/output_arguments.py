"""Options that several commands share: results as JSON, views, recordings and films, and files to replace."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON, and nothing else, on standard output.")]
ViewKind = Annotated[
    str | None,
    typer.Option(metavar="KIND", help="Show the run: window (MuJoCo's viewer), or browser (a web page with controls)."),
]
RunFile = Annotated[Path | None, typer.Option(metavar="FILE", help="Save the recording of all steps as .npz.")]
McapFile = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Save the run as .mcap, with the schemas of the Foxglove viewer.")
]
FilmFile = Annotated[Path | None, typer.Option(metavar="FILE", help="Write a film: .mp4, .gif or .webp (needs no display).")]
FilmFrames = Annotated[Path | None, typer.Option(metavar="DIR", help="Write the frames of the film as PNG.")]
FilmSize = Annotated[str | None, typer.Option(metavar="WxH", help="Size of the film, pixels (default: 1280x720).")]
FilmRate = Annotated[float | None, typer.Option(metavar="N", help="Frames a second of the film (default: 30; animations 15).")]
FilmCamera = Annotated[
    str | None,
    typer.Option(metavar="AZ,EL", help="Turn of the film's camera from where it would stand, and its elevation, degrees."),
]
Force = Annotated[bool, typer.Option("--force", help="Replace existing files. (Pictures in folders are always replaced.)")]
