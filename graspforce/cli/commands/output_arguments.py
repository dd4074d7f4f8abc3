"""Options that several commands share: results as JSON, and files to replace."""

from __future__ import annotations

from typing import Annotated

import typer

AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON, and nothing else, on standard output.")]
Force = Annotated[bool, typer.Option("--force", help="Replace existing files. (Pictures in folders are always replaced.)")]
