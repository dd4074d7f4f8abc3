"""Hold and follow in worlds with errors, from measurements only: python -m benchmarks.real_world [--save FILE].

The controller knows joint positions and, where stated, late camera poses. Each case runs with three hands, a ball of 50 g and
a box of 50 g, in three plants: "links", built from the links of the hand's description, "urdf", the hand's URDF as MuJoCo
compiles it, and "drake", the URDF in another engine (`pip install drake`). Drake's point contact has no torsional friction, so
it lacks the cases with soft pads. Errors are judged by the true state. Displacements count from the start. The table shows the
worst of all hands and objects for each plant, and how many meet the requirement. Without `--longest` a run takes 10 s, with the
camera 60 s.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product

import mujoco
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks import report_page
from benchmarks.real_world_cases import CASES, HANDS, OBJECTS, PLANTS, is_supported, run_case

TITLE = "The controller in worlds with errors"
INSTALLED = tuple(name for name in PLANTS if name != "drake" or importlib.util.find_spec("pydrake"))
Task = tuple[int, str, str, str]  # case, hand, object, plant


def main() -> None:
    """Run all cases, print the table, and save the page."""
    parser = report_page.parser("real_world", __doc__)
    parser.add_argument("--cases", nargs="*", type=int, default=range(len(CASES)), help="numbers of the cases (default: all)")
    parser.add_argument("--hands", nargs="*", default=HANDS, choices=HANDS, help="hands (default: all)")
    parser.add_argument("--plants", type=parse_plants, default=INSTALLED, help="plants, as in links,urdf,drake (default: all)")
    parser.add_argument("--longest", type=float, default=60.0, help="longest simulated time of a run, s (default: 60)")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="number of processes")
    options = parser.parse_args()
    combinations = product(options.cases, options.hands, OBJECTS, options.plants)
    tasks = [task for task in combinations if is_supported(CASES[task[0]], task[3])]
    results = run_tasks(tasks, options.longest, options.workers)
    head = ["world", "requirement", *(f"{plant}: worst" for plant in options.plants), "met"]
    rows = [table_row(i, results, options.plants) for i in options.cases]
    report_page.show(TITLE, head, rows, width=170)
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
            for (i, hand, grasp_object, plant), (measured, is_met) in results.items()
        ]
        page = "\n\n".join(
            [report_page.table(head, rows, len(head)), "## Every run", report_page.table(detail_head, detail, 6)]
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


def run_tasks(tasks: list[Task], longest: float, workers: int) -> dict[Task, tuple[str, bool]]:
    """Return the measured text of each task, and whether its requirement is met.

    Args:
        tasks: case, hand, object and plant of each.
        longest: longest simulated time of a run, s.
        workers: number of processes.
    """
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    context = multiprocessing.get_context("spawn")
    with Progress(*columns) as progress, ProcessPoolExecutor(workers, context) as pool:
        bar = progress.add_task("runs", total=len(tasks))
        futures = [pool.submit(run_task, task, longest) for task in tasks]
        for future in futures:
            future.add_done_callback(lambda _: progress.advance(bar))
        return {task: future.result() for task, future in zip(tasks, futures, strict=True)}


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


def table_row(i: int, results: dict[Task, tuple[str, bool]], plants: tuple[str, ...]) -> tuple[str, ...]:
    """Return the row of a case: its worst result in each plant, and how many runs meet the requirement."""
    cells, met, count = [], 0, 0
    for plant in plants:
        found = {task: result for task, result in results.items() if task[0] == i and task[3] == plant}
        if not found:
            cells.append("–")
            continue
        worst = max(found.values(), key=lambda result: (not result[1], _first_number(result[0])))
        cells.append(worst[0])
        met, count = met + sum(is_met for _, is_met in found.values()), count + len(found)
    return CASES[i].label, CASES[i].requirement, *cells, f"{met} of {count}"


def _first_number(text: str) -> float:
    """Return the first number in a text; infinity if there is none."""
    for word in text.replace(",", " ").split():
        try:
            return float(word)
        except ValueError:
            continue
    return float("inf")


if __name__ == "__main__":
    main()
