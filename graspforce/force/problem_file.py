"""Load a force problem from a JSON file."""

from __future__ import annotations

import os
from pathlib import Path

from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import decode, errors_of_file
from graspforce.force.problem import ForceProblem


def load(path: str | os.PathLike[str]) -> ForceProblem:
    """Return the force problem of a problem file.

    Args:
        path: path of a JSON file with the schema graspforce/problem/1.

    Raises:
        InvalidInput: the file cannot be read, is not JSON, or is not a force problem; names the file.
    """
    try:
        text = Path(path).read_bytes()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InvalidInput("file", os.fspath(path), f"a readable file ({reason})") from None
    with errors_of_file(path):
        return ForceProblem.from_dict(decode(text))
