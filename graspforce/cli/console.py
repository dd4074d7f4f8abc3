"""Console output: results on standard output, errors and progress on standard error."""

from __future__ import annotations

import sys
from typing import Any


def print_error(message: str) -> int:
    """Print an error in one line, and return the exit code 1."""
    print(f"Error: {message}", file=sys.stderr)
    return 1


def print_report(report: object) -> None:
    """Print a table or text, in colour on a terminal. Text from files is not interpreted as markup."""
    from rich.console import Console

    Console(highlight=False, markup=False, emoji=False).print(report)


def progress_console() -> Any:
    """Return the console for progress: standard error, so that piped output stays clean."""
    from rich.console import Console

    return Console(stderr=True)
