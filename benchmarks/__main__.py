"""The command: measure, show a table, keep it as Markdown with the machine's facts."""

from __future__ import annotations

import argparse
import os
import platform
from datetime import date
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn
from rich.table import Table

import graspforce
from benchmarks.timing import Row, measure, pin_to_one_core


def main() -> None:
    """Run the short form, or with --full the long one."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="How long a certified answer takes.")
    parser.add_argument("--full", action="store_true", help="more sizes and more rounds")
    parser.add_argument("--save", type=Path, help="write the table as Markdown to this file")
    options = parser.parse_args()
    sizes = (3, 4, 5, 10, 20, 50) if options.full else (4, 10)
    rounds = 300 if options.full else 60
    pin_to_one_core()
    with Progress(SpinnerColumn(), TextColumn("{task.description}"), transient=True) as progress:
        task = progress.add_task("")
        rows = measure(sizes, rounds, lambda text: progress.update(task, description=text))
    Console(width=120).print(table(rows))
    if options.save:
        options.save.parent.mkdir(parents=True, exist_ok=True)
        options.save.write_text(markdown(rows, rounds))
        print(f"written to {options.save}")


def table(rows: list[Row]) -> Table:
    """The rows for a terminal."""
    shown = Table(
        "contacts", "subject", "median µs", "99 % µs", "max µs", "ratio", "certified", title="Time a certified answer"
    )
    for row in rows:
        shown.add_row(*cells(row))
    return shown


def markdown(rows: list[Row], rounds: int) -> str:
    """The rows as a Markdown page with what they were measured on."""
    lines = [
        "# Time a certified answer takes",
        "",
        f"graspforce {graspforce.__version__}, {date.today()}, {rounds} random feasible problems a size, one process and core.",
        f"{processor()}, {os.cpu_count()} cores, Python {platform.python_version()}. A shared machine: read the ratios.",
        "",
        "The ratio is the median of time over raw Clarabel's time in the same round (its set-up and solve on arrays that are",
        "already built). All else is the whole call: building, solving, certificate, record. An answer that the named solver",
        "did not give itself, or that no certificate stands behind, has no time.",
        "",
        "| contacts | subject | median µs | 99 % µs | max µs | ratio | certified |",
        "|---:|---|---:|---:|---:|---:|---:|",
    ]
    lines += ["| " + " | ".join(cells(row)) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def cells(row: Row) -> list[str]:
    """A row as text."""
    times = [f"{1e6 * seconds:.0f}" for seconds in (row.median, row.p99, row.largest)]
    return [str(row.contacts), row.subject, *times, f"{row.ratio:.2f}", f"{row.certified}/{row.asked}"]


def processor() -> str:
    """The processor's own name, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


if __name__ == "__main__":
    main()
