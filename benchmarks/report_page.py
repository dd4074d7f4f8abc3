"""What a benchmark is asked on the command line, and the Markdown page that it leaves."""

from __future__ import annotations

import argparse
import platform
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from graspforce.bench.race import processor


def parser(name: str, doc: str | None) -> argparse.ArgumentParser:
    """Return the options that every benchmark with a page has."""
    made = argparse.ArgumentParser(prog=f"python -m benchmarks.{name}", description=(doc or "").splitlines()[0])
    made.add_argument("--save", type=Path, help="write the table as Markdown to this file")
    return made


def facts(*versions: str) -> str:
    """Return machine and versions: the named packages, Python and the processor."""
    return f"{', '.join((*versions, f'Python {platform.python_version()}', processor()))}."


def table(head: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> str:
    """Markdown; the first so many columns are words, the others numbers, to the right."""
    lines = ["| " + " | ".join(cells) + " |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * words + "---:|" * (len(head) - words), *lines[1:]])


def save(path: Path, title: str, doc: str | None, facts: str, table: str) -> None:
    """Write a page: title, description, machine and figures."""
    about = " ".join((doc or "").split("\n\n")[1].split())
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"# {title}\n\n{about}\n\n{facts}\n\n{table}\n")


def show(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], width: int | None = None) -> None:
    """Print the same table on the terminal."""
    shown = Table(*head, title=title)
    for row in rows:
        shown.add_row(*row)
    Console(width=width).print(shown)
