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
from benchmarks.subjects import KERNEL_COLD, KERNEL_WARM, SOLVER_WARM, WHOLE
from benchmarks.timing import Row, Throughput, measure, pin, throughput
from graspforce.bench.race import processor

COLUMNS = ("contacts", "subject", "median µs", "99 % µs", "max µs", "× faster than peer", "iterations", "certified")


def main() -> None:
    """Run the short form, or with --full the long one."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="How long a certified answer takes.")
    parser.add_argument("--full", action="store_true", help="3 to 200 contacts and more rounds")
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
        many = throughput(4, 20_000 if options.full else 5_000, 5)
    Console(width=130).print(table(rows))
    print(kernel_overhead(rows))
    print(sentence(many))
    if options.save:
        options.save.parent.mkdir(parents=True, exist_ok=True)
        options.save.write_text(markdown(rows, many, rounds))
        print(f"written to {options.save}")


def table(rows: list[Row]) -> Table:
    """Return the rows as tables for a terminal."""
    shown = Table(*COLUMNS, title="Time a certified answer")
    for row in rows:
        shown.add_row(*cells(row))
    return shown


def sentence(many: Throughput) -> str:
    """Return the throughput as a sentence."""
    return (
        f"{many.problems} stacked problems of {many.contacts} contacts: {many.one_thread:,.0f} certified solves a second on "
        f"one thread, {many.two_threads:,.0f} on two ({many.two_threads / many.one_thread:.2f} ×); "
        f"peak memory of the process {many.peak_memory / 2**20:.0f} MiB."
    )


def kernel_overhead(rows: list[Row]) -> str:
    """Return the cost of checks, units, certificate and record as a sentence."""
    median = {(row.contacts, row.subject): row.median for row in rows}
    shares = [
        f"at {contacts} contacts {median[contacts, WHOLE] / median[contacts, KERNEL_COLD]:.2f} × cold, "
        f"{median[contacts, SOLVER_WARM] / median[contacts, KERNEL_WARM]:.2f} × warm"
        for contacts in dict.fromkeys(row.contacts for row in rows)
    ]
    return (
        "Whole calls beside the kernel alone, which has its arrays and certifies nothing (cold: solve(problem); warm: a step "
        f"of Solver with w, J and tau_u): {'; '.join(shares)}."
    )


def markdown(rows: list[Row], many: Throughput, rounds: int) -> str:
    """Return the rows as a Markdown page, with machine and versions."""
    lines = [
        "# Time a certified answer takes",
        "",
        f"graspforce {graspforce.__version__}, {date.today()}, up to {rounds} bursts of random feasible problems a size, one",
        f"process pinned to one core. {processor()}, {os.cpu_count()} cores, Python {platform.python_version()}. The",
        "machine is shared: read the ratios.",
        "",
        "The ratio is the median of raw Clarabel's time over the subject's on the same problem. Subjects take turns, each with",
        "a burst of problems whose wrench, Jacobian and bias torques differ by up to 1 %, the first to warm up. Raw subjects",
        "are the solver's own call on arrays built already; the others are this package's whole call, certificate and record",
        "included. What no certificate stands behind has no time. Pyramids are another problem than exact cones, with fewer",
        "forces to choose from.",
        "",
        "| " + " | ".join(COLUMNS) + " |",
        "|---:|---|---:|---:|---:|---:|---:|---:|",
    ]
    lines += ["| " + " | ".join(cells(row)) + " |" for row in rows]
    return "\n".join([*lines, "", kernel_overhead(rows), "", sentence(many), ""])


def cells(row: Row) -> list[str]:
    """Return a row as text."""
    times = [f"{1e6 * seconds:.1f}" for seconds in (row.median, row.p99, row.largest)]
    return [str(row.contacts), row.subject, *times, f"{row.ratio:.2f}", f"{row.iterations:.0f}", f"{row.certified}/{row.asked}"]


if __name__ == "__main__":
    main()
