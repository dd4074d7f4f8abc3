"""Problems labelled on Dask workers in separate processes: `python -m benchmarks.labelling --save FILE`.

`graspforce.solve_many` labels the problems of the library, repeated, from one Parquet file to a folder of Parquet files, with
one worker and with two workers of one thread each. Then one of two workers is killed when half of the parts are written. The
runs with one worker and with a killed one can have fewer rows (`--short`). *Ratio* is that of the rates. *Whole*: every row is
there once. *CPU*: processor time of the workers per row, which other programs on the machine change less than the rate.
Workers import the package before the clock starts.
"""

from __future__ import annotations

import importlib
import json
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import islice
from pathlib import Path

import psutil
import pyarrow
import pyarrow.parquet
from distributed import Client

import graspforce as gf
from benchmarks import report_page
from benchmarks.dask_processes import scheduler, worker
from graspforce import problems
from graspforce.analysis import solve_many as labelled
from graspforce.analysis.solve_many import LabelledParts

HEAD = ("workers", "rows", "parts", "time, s", "rows/s", "ratio", "CPU, ms/row", "whole")
ROWS_PER_PART, MOST_CONTACTS = 500, 10


def write_source(path: Path, rows: int) -> None:
    """Write problems of the library with at most `MOST_CONTACTS` contacts, repeated.

    Args:
        path: the Parquet file.
        rows: number of rows.
    """
    cases = (problems.load(name).problem for name in problems.names("ist"))
    texts = [json.dumps(one.to_dict()) for one in islice(cases, 400) if len(one.contacts) <= MOST_CONTACTS]
    with pyarrow.parquet.ParquetWriter(path, pyarrow.schema([("problem", pyarrow.string())])) as file:
        for first in range(0, rows, ROWS_PER_PART):
            repeated = [texts[i % len(texts)] for i in range(first, min(first + ROWS_PER_PART, rows))]
            file.write_table(pyarrow.table({"problem": repeated}), row_group_size=ROWS_PER_PART)


@contextmanager
def cluster(folder: Path, count: int) -> Iterator[tuple[str, list[int]]]:
    """Run a scheduler and workers that have imported the package; yield the address and the numbers of their processes.

    Args:
        folder: folder for the scheduler's file.
        count: number of workers.
    """
    with ExitStack() as stack:
        address = stack.enter_context(scheduler(folder))
        processes = [stack.enter_context(worker(address, f"worker {i}")) for i in range(count)]
        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=300)
            client.run(importlib.import_module, labelled.__name__)
        yield address, [process.pid for process in processes]


def label(source: Path, workers: int, killed: bool = False) -> tuple[LabelledParts, float, float, bool]:
    """Return the parts, the time and the processor time of the workers, both in s, and whether every row is there once.

    Args:
        source: the Parquet file.
        workers: number of workers.
        killed: whether one worker is killed when half of the parts are written.
    """
    with tempfile.TemporaryDirectory() as folder, cluster(Path(folder), workers) as (address, numbers):
        used = -sum(map(processor_time, numbers))

        def kill(done: int, of: int) -> None:
            nonlocal used
            if killed and len(numbers) == workers and done == of // 2:
                used += processor_time(numbers[-1])
                os.kill(numbers.pop(), 9)

        begin = time.perf_counter()
        parts = gf.solve_many(source, Path(folder) / "out", cluster=address, rows_per_part=ROWS_PER_PART, progress=kill)
        elapsed = time.perf_counter() - begin
        used += sum(map(processor_time, numbers))
        files = sorted(parts.folder.glob("part-*"))
        rows = [row for file in files for row in pyarrow.parquet.read_table(file, columns=["row"]).column("row").to_pylist()]
        return parts, elapsed, used, rows == list(range(parts.rows))


def processor_time(process: int) -> float:
    """Return the processor time of a process, s.

    Args:
        process: its number.
    """
    times = psutil.Process(process).cpu_times()
    return float(times.user + times.system)


def main() -> None:
    """Label with one worker, two workers, and two of which one is killed; print the table and write the page."""
    parser = report_page.parser("labelling", __doc__)
    parser.add_argument("--rows", type=int, default=20_000, help="number of problems (default: 20000)")
    parser.add_argument("--short", type=int, help="number of problems of one worker and of the run with a kill (default: ROWS)")
    options = parser.parse_args()
    rows, first, short = [], 0.0, options.short or options.rows
    with tempfile.TemporaryDirectory() as folder:
        for workers, killed, count in ((1, False, short), (2, False, options.rows), (2, True, short)):
            source = Path(folder) / f"{count}.parquet"
            if not source.exists():
                write_source(source, count)
            parts, elapsed, used, whole = label(source, workers, killed)
            rate = parts.rows / elapsed
            first = first or rate
            name = f"{workers}, one killed at half" if killed else str(workers)
            numbers = (
                f"{elapsed:.1f}",
                f"{rate:.0f}",
                f"{rate / first:.2f}",
                f"{1e3 * used / parts.rows:.2f}",
                "yes" if whole else "no",
            )
            rows.append((name, str(parts.rows), str(parts.parts), *numbers))
    report_page.show("Labelling", HEAD, rows, width=120)
    if options.save:
        load = ", ".join(f"{one:.1f}" for one in os.getloadavg())
        versions = report_page.facts(f"graspforce {gf.__version__}")
        facts = f"{versions} Load of the machine at the end: {load} on {os.cpu_count()} cores."
        report_page.save(options.save, "Labelling on a cluster", __doc__, facts, report_page.table(HEAD, rows))


if __name__ == "__main__":
    main()
