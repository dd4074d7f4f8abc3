"""Command-line options, tables and Markdown pages shared by the benchmarks."""

from __future__ import annotations

import argparse
import os
import platform
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from graspforce.bench.conditions import processor


def parser(name: str, doc: str | None) -> argparse.ArgumentParser:
    """Return a parser with the options that every benchmark with a page has.

    Args:
        name: name of the module.
        doc: docstring of the module; its first line is the description.
    """
    options = argparse.ArgumentParser(prog=f"python -m benchmarks.{name}", description=(doc or "").splitlines()[0])
    options.add_argument("--save", type=Path, help="write the table as Markdown to this file")
    return options


def facts(*versions: str) -> str:
    """Return machine and versions in one sentence: the given versions, Python and the processor.

    Args:
        versions: names and versions of packages.
    """
    return f"{', '.join((*versions, f'Python {platform.python_version()}', processor()))}."


def table(head: Sequence[str], rows: Iterable[Sequence[str]], text_columns: int = 1) -> str:
    """Return a Markdown table.

    Args:
        head: headings.
        rows: cells of each row.
        text_columns: number of leading columns aligned to the left; the others are numbers, aligned to the right.
    """
    lines = ["| " + " | ".join(cells) + " |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * text_columns + "---:|" * (len(head) - text_columns), *lines[1:]])


def command() -> str:
    """Return the command line of the running benchmark, without --save and its file."""
    given = list(sys.argv[1:])
    if "--save" in given:
        i = given.index("--save")
        del given[i : i + 2]
    given = [argument for argument in given if not argument.startswith("--save=")]
    return " ".join(["python -m", f"benchmarks.{Path(sys.argv[0]).stem}", *given])


def save(path: Path, title: str, doc: str | None, facts: str, table: str) -> None:
    """Write a page: title, description, machine, command and figures.

    Args:
        path: the file; its folder is created if missing.
        title: title of the page.
        doc: docstring of the module; its paragraphs after the first line are the description.
        facts: machine and versions.
        table: tables in Markdown.
    """
    about = [" ".join(paragraph.split()) for paragraph in (doc or "").split("\n\n")[1:]]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n\n".join([f"# {title}", *about, f"{facts} Command: `{command()}`.", table]) + "\n")


def show(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], width: int | None = None) -> None:
    """Print a table on the terminal.

    Args:
        title: title of the table.
        head: headings.
        rows: cells of each row.
        width: width of the terminal in characters; detected by default.
    """
    shown = Table(*head, title=title)
    for row in rows:
        shown.add_row(*row)
    Console(width=width).print(shown)


def publish(
    title: str,
    doc: str | None,
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    path: Path | None,
    *counts: str,
    text_columns: int = 1,
    width: int | None = None,
) -> None:
    """Print a table, and write its page with the number of cores and the load of the machine if there is a file.

    Args:
        title: title of the table and the page.
        doc: docstring of the module, as in `save`.
        head: headings.
        rows: cells of each row.
        path: the file; None for none.
        counts: further facts, such as the number of measurements.
        text_columns: number of leading columns aligned to the left on the page.
        width: width of the terminal in characters; detected by default.
    """
    show(title, head, rows, width)
    if path is not None:
        machine = f"{os.cpu_count()} cores", *counts, f"load average {os.getloadavg()[0]:.1f}"
        save(path, title, doc, facts(*machine), table(head, rows, text_columns))
