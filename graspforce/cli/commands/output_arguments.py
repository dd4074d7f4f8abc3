"""Options that several commands share: results as JSON, and files to replace."""

from __future__ import annotations

from typing import Annotated

import typer

AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON, and nothing else, on standard output.")]
FilmSize = Annotated[str | None, typer.Option(metavar="WxH", help="Size of the film, pixels (default: 1280x720).")]
FilmRate = Annotated[float | None, typer.Option(metavar="N", help="Frames a second of the film (default: 30; animations 15).")]
FilmCamera = Annotated[
    str | None,
    typer.Option(metavar="AZ,EL", help="Turn of the film's camera from where it would stand, and its elevation, degrees."),
]
Force = Annotated[bool, typer.Option("--force", help="Replace existing files. (Pictures in folders are always replaced.)")]
