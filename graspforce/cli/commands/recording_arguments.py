"""Arguments of the commands that read a server's recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from graspforce.cli.completions import complete_hand

RecordingFile = Annotated[Path, typer.Argument(metavar="FILE", help="A recording that `graspforce serve --record` wrote.")]
HandsInPlace = Annotated[
    list[str] | None,
    typer.Option(
        "--hand",
        metavar="NAME",
        help="Hand in place of the recorded one with its name; repeatable.",
        autocompletion=complete_hand,
    ),
]
