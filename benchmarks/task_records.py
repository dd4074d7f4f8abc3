"""Tasks of a benchmark in several processes, with a file of their results that a later run continues."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import subprocess
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from graspforce import GraspForceError

Task = tuple[Any, ...]  # texts and numbers
Record = dict[str, Any]


def run_tasks(
    function: Callable[[Task], Record], tasks: Sequence[Task], path: Path, workers: int, budget: float = math.inf
) -> dict[Task, Record]:
    """Return the results of tasks by task: those in the file, and those that are run now and appended to it.

    A result has the commit at which it was measured. A task that raises an error of graspforce gets a result with `error`.

    Args:
        function: of a module, computes the result of a task, a plain record.
        tasks: the tasks, in the order in which they run.
        path: file of results, one JSON record a line; it is made if it is missing.
        workers: number of processes.
        budget: time after which no further task is started, s.
    """
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    results = {tuple(line["task"]): line for line in lines}
    missing = [task for task in tasks if task not in results]
    end, commit = time.monotonic() + budget, _commit()
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    context = multiprocessing.get_context("spawn")
    with Progress(*columns) as progress, ProcessPoolExecutor(workers, context) as pool, path.open("a") as file:
        bar = progress.add_task("tasks", total=len(missing))
        for start in range(0, len(missing), workers):
            if time.monotonic() > end:
                break
            batch = missing[start : start + workers]
            for task, result in zip(batch, pool.map(_guarded, [function] * len(batch), batch), strict=True):
                results[task] = {"task": list(task), "commit": commit, **result}
                file.write(json.dumps(results[task]) + "\n")
                file.flush()
                progress.advance(bar)
    return {task: results[task] for task in tasks if task in results}


def _guarded(function: Callable[[Task], Record], task: Task) -> Record:
    """Return the result of a task, or the text of its error."""
    try:
        return function(task)
    except GraspForceError as error:
        return {"error": str(error)[:200]}


def _commit() -> str:
    """Return the short name of the commit that is checked out."""
    folder = Path(__file__).parents[1]
    command = ["git", "rev-parse", "--short", "HEAD"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"
