"""Hold and follow in worlds with errors, from measurements only: python -m benchmarks.real_world [--save FILE].

The controller knows joint positions and, where stated, late camera poses. Each case runs with three hands, a ball of 50 g and
a box of 50 g, in three plants: "links", built from the links of the hand's description, "urdf", the hand's URDF as MuJoCo
compiles it, and "drake", the URDF in another engine (`pip install drake`). Drake's point contact has no torsional friction, so
it lacks the cases with soft pads. Drake makes 25 steps of 40 µs in each control period, because its regularised friction lets
contacts creep in proportion to its step. Errors are judged by the true state. Displacements count from the start. The table
shows the worst of all hands and objects for each plant, and how many meet the requirement. Encoders are exact except with the
camera (0.1 mrad). Without `--longest` a run takes 10 s, with the camera 60 s, and with lost drives 3 s.

The results are in a file, one line for each run, which the next call continues. So the runs can be done in slices.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import math
import multiprocessing
import os
import re
import time
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import replace
from itertools import product
from pathlib import Path

import mujoco
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks import report_page
from benchmarks.real_world_cases import CASES, HANDS, OBJECTS, PLANTS, is_supported, run_case
from graspforce.core.result_file import ResultFile

TITLE = "The controller in worlds with errors"
INSTALLED = tuple(name for name in PLANTS if name != "drake" or importlib.util.find_spec("pydrake"))
SCHEMA = "graspforce/real_world/1"
RECORDS = Path("benchmarks/results/records/real_world.jsonl")
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
Task = tuple[int, str, str, str]  # case, hand, object, plant
Results = dict[Task, tuple[str, bool]]  # the measured text, and whether the requirement is met


def main() -> None:
    """Run the missing cases, print the table, and save the page."""
    parser = report_page.parser("real_world", __doc__)
    parser.add_argument("--cases", nargs="*", type=int, default=range(len(CASES)), help="numbers of the cases (default: all)")
    parser.add_argument("--hands", nargs="*", default=HANDS, choices=HANDS, help="hands (default: all)")
    parser.add_argument("--plants", type=parse_plants, default=INSTALLED, help="plants, as in links,urdf,drake (default: all)")
    parser.add_argument("--longest", type=float, default=60.0, help="longest simulated time of a run, s (default: 60)")
    parser.add_argument("--results", type=Path, default=RECORDS, help="file of results, continued")
    parser.add_argument("--slice", type=float, help="start no run after this time, s (default: run to the end)")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="number of processes")
    options = parser.parse_args()
    combinations = product(options.cases, options.hands, OBJECTS, options.plants)
    tasks = [task for task in combinations if is_supported(CASES[task[0]], task[3])]
    tasks.sort(key=lambda task: options.plants.index(task[3]))  # a slice has all cases of the first plants
    with ResultFile(options.results, SCHEMA, {"longest": options.longest}) as file:
        found = results_of(file)
        run_tasks([task for task in tasks if task not in found], file, options)
        found = results_of(file)
    report({task: found[task] for task in tasks if task in found}, len(tasks), options)


def report(results: Results, total: int, options: argparse.Namespace) -> None:
    """Print the table and the runs that do not meet their requirement, and write the page.

    Args:
        results: the runs so far.
        total: number of all runs.
        options: of the command line.
    """
    head = ["world", "requirement", *(f"{plant}: worst" for plant in options.plants), "met"]
    rows = [table_row(i, results, options.plants) for i in options.cases]
    report_page.show(TITLE, head, rows, width=170)
    state = f"{len(results)} of {total} runs."
    print(state)
    for (i, hand, grasp_object, plant), (measured, is_met) in results.items():
        if not is_met:
            print(f"not met: {CASES[i].label}: {hand}, {grasp_object}, {plant}: {measured}")
    if options.save:
        versions = [f"MuJoCo {mujoco.__version__}"]
        if "drake" in options.plants:
            versions.append(f"Drake {importlib.metadata.version('drake')}")
        detail_head = ["world", "hand", "object", "plant", "measured", "met"]
        detail = [
            (CASES[i].label, hand, grasp_object, plant, measured, "yes" if is_met else "no")
            for (i, hand, grasp_object, plant), (measured, is_met) in sorted(results.items())
        ]
        page = "\n\n".join(
            [state, report_page.table(head, rows, len(head)), "## Every run", report_page.table(detail_head, detail, 6)]
        )
        report_page.save(options.save, TITLE, __doc__, report_page.facts(*versions), page)


def parse_plants(text: str) -> tuple[str, ...]:
    """Return the plants of an option such as links,urdf,drake.

    Args:
        text: names, separated by commas.
    """
    names = tuple(text.split(","))
    for name in names:
        if name not in INSTALLED:
            raise argparse.ArgumentTypeError(f"{name}: must be one of {', '.join(INSTALLED)}; Drake needs pip install drake")
    return names


def results_of(file: ResultFile) -> Results:
    """Return the runs in a file; those of cases that no longer exist are left out.

    Args:
        file: the results.
    """
    cases = {case.label: i for i, case in enumerate(CASES)}
    return {
        (cases[run["world"]], run["hand"], run["object"], run["plant"]): (run["measured"], run["met"])
        for run in file.records
        if run["world"] in cases
    }


def run_tasks(tasks: list[Task], file: ResultFile, options: argparse.Namespace) -> None:
    """Run cases in several processes until the end or the end of the slice, and add each to the file.

    Args:
        tasks: case, hand, object and plant of each.
        file: the results.
        options: of the command line.
    """
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    end = float("inf") if options.slice is None else time.monotonic() + options.slice
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    context = multiprocessing.get_context("spawn")
    with Progress(*columns) as progress, ProcessPoolExecutor(options.workers, context) as pool:
        bar = progress.add_task("runs", total=len(tasks))
        pending, running = list(reversed(tasks)), {}
        while True:
            while pending and len(running) < options.workers and time.monotonic() < end:
                task = pending.pop()
                running[pool.submit(run_task, task, options.longest)] = task
            if not running:
                break
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                (i, hand, grasp_object, plant), (measured, is_met) = running.pop(future), future.result()
                run = {"world": CASES[i].label, "hand": hand, "object": grasp_object, "plant": plant}
                file.append({**run, "measured": measured, "met": is_met})
                progress.advance(bar)


def run_task(task: Task, longest: float) -> tuple[str, bool]:
    """Run one case. An exception is a case that is not met.

    Args:
        task: case, hand, object and plant.
        longest: longest simulated time, s.
    """
    i, hand, grasp_object, plant = task
    case = replace(CASES[i], duration=min(CASES[i].duration, longest))
    try:
        return run_case(case, hand, grasp_object, plant)
    except Exception as error:  # shown in the table
        return f"{type(error).__name__}: {error}"[:120], False


def table_row(i: int, results: Results, plants: tuple[str, ...]) -> tuple[str, ...]:
    """Return the row of a case: its worst figures in each plant, and how many runs meet the requirement."""
    cells, met, count = [], 0, 0
    for plant in plants:
        found = {task: result for task, result in results.items() if task[0] == i and task[3] == plant}
        if not found:
            cells.append("–")
            continue
        failed = [text for text, is_met in found.values() if not is_met]
        cells.append(worst_figures(failed or [text for text, _ in found.values()]))
        met, count = met + sum(is_met for _, is_met in found.values()), count + len(found)
    return CASES[i].label, CASES[i].requirement, *cells, f"{met} of {count}"


def worst_figures(texts: list[str]) -> str:
    """Return a text with the largest of each figure among texts that differ in their numbers only.

    Of texts with other words, those count that have the words of the text with the largest first figure.

    Args:
        texts: results, such as "slip 0.02 mm, squeeze 1.10 ×".
    """
    words = {text: _NUMBER.split(text) for text in texts}
    figures = {text: [float(number) for number in _NUMBER.findall(text)] for text in texts}
    first = max(texts, key=lambda text: figures[text][0] if figures[text] else math.inf)
    same = [text for text in texts if words[text] == words[first]]
    largest = [max(same, key=lambda text: figures[text][k]) for k in range(len(figures[first]))]
    numbers = [_NUMBER.findall(text)[k] for k, text in enumerate(largest)]
    return "".join(word + number for word, number in zip(words[first], [*numbers, ""], strict=True))


if __name__ == "__main__":
    main()
