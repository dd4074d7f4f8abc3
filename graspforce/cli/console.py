"""Console output: results on standard output, errors and progress on standard error."""

from __future__ import annotations

import sys
from typing import Any

SUCCESS, ERROR, USAGE, INFEASIBLE = range(4)
"""Exit codes. ERROR is also a failed run, USAGE a wrong command line, INFEASIBLE a proof that there is no solution."""

INTERRUPTED = 130  # as of a process that SIGINT ends
_UNBROKEN = 10_000  # columns, without a terminal: files and other programs get lines that are neither wrapped nor cut


def print_error(message: str, code: int = ERROR) -> int:
    """Print an error in one line, and return the exit code."""
    print(f"Error: {message}", file=sys.stderr)
    return code


def is_terminal() -> bool:
    """Return whether standard output is a terminal."""
    return sys.stdout.isatty()


def report_console() -> Any:
    """Return the console for results: as wide as the terminal, or without a limit if standard output is none."""
    from rich.console import Console

    return Console(highlight=False, emoji=False, width=None if is_terminal() else _UNBROKEN)


def print_report(report: object) -> None:
    """Print a table or text, in colour on a terminal. Text from files is not interpreted as markup."""
    report_console().print(report, markup=False)


def progress_console() -> Any:
    """Return the console for progress: standard error, so that piped output stays clean."""
    from rich.console import Console

    return Console(stderr=True)
