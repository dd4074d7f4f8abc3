"""Time the structured kernel, its warm starts and its batches: `python -m benchmarks [--full] [--save FILE]`."""

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
from benchmarks.subjects import KERNEL_COLD, KERNEL_WARM, SOLVER_WARM, WHOLE
from benchmarks.timing import Row, Throughput, measure, pin, throughput
from graspforce.bench.conditions import processor

COLUMNS = ("contacts", "subject", "median µs", "99 % µs", "max µs", "speed-up over raw Clarabel", "iterations", "certified")


def main() -> None:
    """Measure, print the tables and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Measure the time per certified solution.")
    parser.add_argument("--full", action="store_true", help="3 to 200 contacts, and more rounds")
    parser.add_argument("--save", type=Path, help="write the tables as Markdown to this file")
    options = parser.parse_args()
    sizes = (3, 4, 5, 10, 20, 50, 200) if options.full else (4, 10, 50)
    rounds = 50 if options.full else 15
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    pin(None)
    with Progress(SpinnerColumn(), TextColumn("{task.description}"), transient=True) as progress:
        task = progress.add_task("")
        rows = measure(sizes, rounds, lambda text: progress.update(task, description=text))
        progress.update(task, description="stacked problems on one thread and on two")
        pin(cores)
        batch = throughput(4, 20_000 if options.full else 5_000, 5)
    Console(width=130).print(table(rows))
    print(kernel_overhead(rows))
    print(sentence(batch))
    if options.save:
        options.save.parent.mkdir(parents=True, exist_ok=True)
        options.save.write_text(markdown(rows, batch, rounds, "--full" if options.full else ""))
        print(f"written to {options.save}")


def table(rows: list[Row]) -> Table:
    """Return the rows as a table for a terminal."""
    shown = Table(*COLUMNS, title="Time per certified solution")
    for row in rows:
        shown.add_row(*cells(row))
    return shown


def sentence(batch: Throughput) -> str:
    """Return the throughput as a sentence."""
    return (
        f"{batch.problems} stacked problems of {batch.contacts} contacts: {batch.one_thread:,.0f} certified solves per second "
        f"on one thread, {batch.two_threads:,.0f} on two ({batch.two_threads / batch.one_thread:.2f} ×); "
        f"peak memory of the process {batch.peak_memory / 2**20:.0f} MiB."
    )


def kernel_overhead(rows: list[Row]) -> str:
    """Return the overhead of checks, units, certificate and record as a sentence."""
    median = {(row.contacts, row.subject): row.median for row in rows}
    shares = [
        f"at {contacts} contacts {median[contacts, WHOLE] / median[contacts, KERNEL_COLD]:.2f} × cold, "
        f"{median[contacts, SOLVER_WARM] / median[contacts, KERNEL_WARM]:.2f} × warm"
        for contacts in dict.fromkeys(row.contacts for row in rows)
    ]
    return (
        "Time of whole calls over the time of the kernel alone, which gets packed arrays and computes no certificate (cold: "
        f"solve(problem); warm: a step of Solver with w, J and tau_u): {'; '.join(shares)}."
    )


def markdown(rows: list[Row], batch: Throughput, rounds: int, options: str) -> str:
    """Return the rows as a Markdown page, with machine, versions and command."""
    lines = [
        "# Time per certified solution",
        "",
        f"graspforce {graspforce.__version__}, {date.today()}, up to {rounds} bursts of random feasible problems per size, one",
        f"process pinned to one core. {processor()}, {os.cpu_count()} cores, Python {platform.python_version()}. The",
        f"machine is shared; use the ratios. Command: `{' '.join(['python -m benchmarks', options]).strip()}`.",
        "",
        "The speed-up is the median of raw Clarabel's time over the subject's time on the same problem. Subjects take turns.",
        "Each solves a burst of problems whose wrench, Jacobian and bias torques differ by up to 1 %; the first solve of a",
        "burst is not timed. Raw subjects are the solver's own call on arrays built beforehand. The others are whole calls of",
        "this package, with certificate and record. Only certified solutions are timed. Inner pyramids admit fewer forces",
        "than exact cones, so their problems differ.",
        "",
        "| " + " | ".join(COLUMNS) + " |",
        "|---:|---|---:|---:|---:|---:|---:|---:|",
    ]
    lines += ["| " + " | ".join(cells(row)) + " |" for row in rows]
    return "\n".join([*lines, "", kernel_overhead(rows), "", sentence(batch), ""])


def cells(row: Row) -> list[str]:
    """Return the cells of a row."""
    times = [f"{1e6 * seconds:.1f}" for seconds in (row.median, row.p99, row.largest)]
    return [
        str(row.contacts),
        row.subject,
        *times,
        f"{row.ratio:.2f}",
        f"{row.iterations:.0f}",
        f"{row.certified}/{row.attempted}",
    ]


if __name__ == "__main__":
    main()
