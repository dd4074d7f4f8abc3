"""The benchmark on the whole library, in parts and on several machines: ``python -m benchmarks.suite run --save FILE``.

``run`` appends outcomes to a file. It skips the tasks that the file holds, so that it can be interrupted and started again.
``--slice K/N`` runs a part of the cases, which samples every collection evenly. ``pages`` merges files into one packed record,
and writes two reports from it and the numbers of the README's table. ``compare`` compares two records, and names the tasks
whose verdicts differ. ``pages --repeat FILE`` also marks these tasks as varying; the worse verdict counts.

The tasks, each with at most `LIMIT` of processor time per solve:

- every solver on every case, with default settings, in the units of the problem, cold, and warm along sequences;
- the collections `hard` and `infeasible` with default and high settings in SI units;
- the smoke set with low and high settings and in single precision, in the units of the problem.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks import report_page
from graspforce import problems
from graspforce.bench import race
from graspforce.bench.blocks import order_in_blocks, select_slice
from graspforce.bench.conditions import race_conditions
from graspforce.bench.judge import Verdict, worst_judgement
from graspforce.bench.local_workers import run_tasks_here
from graspforce.bench.merge import merge_races, pack
from graspforce.bench.outcome import RaceOutcome, RaceTask, load
from graspforce.bench.registry import SOLVERS
from graspforce.bench.statistics import compare_races
from graspforce.core.whole_file import write_text

RESULTS = Path(__file__).parent / "results"
RECORD = RESULTS / "records" / "suite" / "run-1.jsonl.xz"
LIMIT = 1.0  # s
HARD = ("hard", "infeasible")
_SHOWN_SECONDS = 10.0  # between two lines of progress
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS")
# of the processes of solvers: one thread each; JAX compiles for the processor, and keeps its compiled code
_ENVIRONMENT = dict.fromkeys(_THREADS, "1") | {
    "JAX_PLATFORMS": "cpu",
    "JAX_COMPILATION_CACHE_DIR": str(Path(tempfile.gettempdir()) / f"graspforce-suite-jax-{os.getuid()}"),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
}


def suite_plans(solvers: Sequence[str] = ()) -> tuple[race.RacePlan, ...]:
    """Return the plans of the suite.

    Args:
        solvers: names of the solvers; all installed ones by default.
    """
    whole = race.make_race_plan(solvers, max_cases=0, limit=LIMIT)
    hard = replace(whole, settings=("default", "high"), units=("si",), collections=HARD)
    return whole, hard, replace(whole, settings=("low", "high", "float32"), cases=problems.smoke_names())


def suite_tasks(plans: Iterable[race.RacePlan]) -> list[RaceTask]:
    """Return the tasks of plans without repetition, in blocks of cases that sample every collection.

    Args:
        plans: the plans.
    """
    return order_in_blocks(dict.fromkeys(task for plan in plans for task in race.race_tasks(plan)))


def run(options: argparse.Namespace) -> None:
    """Run the tasks that the files do not hold yet."""
    os.environ |= _ENVIRONMENT
    plans = suite_plans(options.solver)
    tasks = suite_tasks(plans)
    if options.slice:
        tasks = select_slice(tasks, *options.slice)
    done = {outcome.task for path in options.skip for outcome in load(path)[1]}
    end = time.monotonic() + 60.0 * options.minutes
    shown = time.monotonic()

    def show(what: str, count: int, of: int) -> None:
        nonlocal shown
        if time.monotonic() - shown >= _SHOWN_SECONDS or count in (0, of):
            shown = time.monotonic()
            print(f"{time.strftime('%H:%M:%S')} {count}/{of} {what}", flush=True)

    def start(missing: Sequence[RaceTask]) -> Any:
        return run_tasks_here(missing, LIMIT, options.workers, lambda: time.monotonic() > end)

    wanted = [task for task in tasks if task not in done]
    _, outcomes = race.run_tasks(wanted, race_conditions(plans[0].solvers, LIMIT), start, options.save, show, options.workers)
    print(f"{len(outcomes)} of {len(wanted)} tasks done: {options.save}")


def pages(options: argparse.Namespace) -> None:
    """Merge files, write the record, the reports of the suite and of its hard cases in SI units, and the history."""
    from graspforce.bench import report, site  # these draw figures; the processes of solvers do without

    conditions, outcomes = merge_races(options.files)
    if options.repeat is not None:
        text, outcomes = _repeated(outcomes, load(options.repeat)[1])
        write_text(options.results / "suite" / "repeat.md", text)
    pack(options.record, conditions, outcomes)
    print(f"{len(outcomes)} runs, {options.record.stat().st_size / 1e6:.2f} MB: {options.record}")
    known = {outcome.task for outcome in outcomes}
    missing = [task for task in suite_tasks(suite_plans(options.solver)) if task not in known]
    for folder, units in (("suite", "scaled"), ("suite-hard", "si")):
        own = [outcome for outcome in outcomes if outcome.task.units == units]
        lacking = sum(task.units == units for task in missing)
        command = "python -m benchmarks.suite run --save FILE"
        if own:
            facts = {**conditions, "missing": lacking, "sessions": _sessions_of(conditions, own)}
            print(report.write(options.results / folder, facts, _ordered(own), command))
    own = [outcome for outcome in outcomes if outcome.task.units == "scaled"]
    site.save_history(options.results / "suite" / "history.json", conditions, _ordered(own))


def _repeated(first: Sequence[RaceOutcome], second: Sequence[RaceOutcome]) -> tuple[str, list[RaceOutcome]]:
    """Return a page about two runs, and the outcomes of the first run, in which tasks with different verdicts are varying."""
    changed, _ = compare_races(first, second)
    worse = {old.task: _worse(old, new) for old, new in changed}
    shared = len({outcome.task for outcome in first} & {outcome.task for outcome in second})
    limit = sum(Verdict.TIMED_OUT in (old.judgement.verdict, new.judgement.verdict) for old, new in changed)
    rows = sorted(
        (new.task.solver, new.task.case, _kind(new.task), old.judgement.verdict.value, new.judgement.verdict.value)
        for old, new in changed
    )
    table = report_page.table(("solver", "case", "settings", "first run", "second run"), rows, text_columns=5)
    share = f"{len(changed)} verdicts differ ({100.0 * len(changed) / max(shared, 1):.3f} %)"
    about = (
        f"{shared} tasks ran in both: {share}, {limit} of them because one run reached the limit of {LIMIT:g} s of processor "
        "time. The reports count the worse verdict and mark these tasks as varying."
    )
    text = "\n\n".join(["# Two runs of the whole suite", about, table]) + "\n"
    return text, [worse.get(outcome.task, outcome) for outcome in first]


def _worse(old: RaceOutcome, new: RaceOutcome) -> RaceOutcome:
    """Return the outcome with the worse verdict, marked as varying."""
    worst = worst_judgement((old.judgement, new.judgement))
    return replace(old if worst is old.judgement else new, verdict_varies=True)


def _kind(task: RaceTask) -> str:
    """Return settings, units, cones and start of a task."""
    return " ".join([task.settings, task.units, "pyramid" if task.pyramid else "exact", *["warm"] * task.warm])


def _sessions_of(conditions: dict[str, Any], outcomes: Sequence[RaceOutcome]) -> list[dict[str, Any]]:
    """Return the sessions of a record with the number of tasks in a part of it, which a record of several does not tell."""
    sessions = [dict(session) for session in conditions["sessions"]]
    for session in sessions:
        session.pop("tasks", None)
    if len(sessions) == 1:
        sessions[0]["tasks"] = Counter(outcome.task.solver for outcome in outcomes)
    return sessions


def _ordered(outcomes: Iterable[RaceOutcome]) -> list[RaceOutcome]:
    """Return outcomes by settings, then by kind of cone, then by solver as the registry lists them."""
    settings, solvers = ("default", "low", "high", "float32"), tuple(SOLVERS)

    def place(outcome: RaceOutcome) -> tuple[Any, ...]:
        task = outcome.task
        return settings.index(task.settings), task.pyramid, solvers.index(task.solver), task.case, task.warm

    return sorted(outcomes, key=place)


def compare(options: argparse.Namespace) -> int:
    """Print the tasks whose verdicts differ between two records, and return how many are not named as varying."""
    (_, before), (_, now) = load(options.files[0]), load(options.files[1])
    changed, ratios = compare_races(before, now)
    shared = len({outcome.task for outcome in before} & {outcome.task for outcome in now})
    unnamed = 0
    for old, new in changed:
        named = old.verdict_varies or new.verdict_varies
        unnamed += not named
        verdicts = f"{old.judgement.verdict.value} → {new.judgement.verdict.value}"
        print(f"{new.task.solver} {new.task.case} ({_kind(new.task)}): {verdicts}{' (named as varying)' * named}")
    print(f"{shared} tasks in both: {len(changed)} verdicts differ, of which {len(changed) - unnamed} are named as varying.")
    print("Times, second over first: " + ", ".join(f"{solver} {ratio:.2f}" for solver, ratio in ratios.items()))
    return unnamed


def parse_slice(text: str) -> tuple[int, int]:
    """Return K and N of ``K/N``."""
    part, parts = text.split("/")
    return int(part), int(parts)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return 1 if two records differ in verdicts that are not named as varying."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.suite", description=(__doc__ or "").splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run", help="run the tasks that are missing")
    running.add_argument("--save", type=Path, required=True, help="outcome file, .jsonl")
    running.add_argument("--slice", type=parse_slice, help="K/N: only the K-th of N slices of the cases")
    running.add_argument("--workers", type=int, default=1, help="tasks that run at once (default: 1)")
    running.add_argument("--minutes", type=float, default=float("inf"), help="start no task after this time")
    running.add_argument("--skip", type=Path, nargs="*", default=[], help="outcome files with tasks to skip")
    writing = commands.add_parser("pages", help="merge outcome files, and write the record and the pages")
    writing.add_argument("files", type=Path, nargs="+", help="outcome files, .jsonl or .jsonl.xz")
    writing.add_argument("--repeat", type=Path, help="outcome file of a second run: tasks with another verdict are varying")
    writing.add_argument("--record", type=Path, default=RECORD, help="packed record to write, .jsonl.xz")
    writing.add_argument("--results", type=Path, default=RESULTS, help="folder of the pages")
    for one in (running, writing):
        one.add_argument("--solver", action="append", default=[], help="a solver; repeatable (default: all installed)")
    comparing = commands.add_parser("compare", help="compare the verdicts of two records")
    comparing.add_argument("files", type=Path, nargs=2)
    options = parser.parse_args(arguments)
    if options.command == "compare":
        return int(compare(options) > 0)
    (run if options.command == "run" else pages)(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
