"""What commands say: answers on standard output, complaints and progress on standard error."""

from __future__ import annotations

import sys
from typing import Any


def print_error(message: str) -> int:
    """Say in one line what went wrong, and return the exit code."""
    print(f"Error: {message}", file=sys.stderr)
    return 1


def print_report(report: object) -> None:
    """Print a table or text, in colour where the output is a terminal; what files say is not taken for markup."""
    from rich.console import Console

    Console(highlight=False, markup=False, emoji=False).print(report)


def progress_console() -> Any:
    """Where progress is shown: standard error, so that what is piped stays clean."""
    from rich.console import Console

    return Console(stderr=True)
