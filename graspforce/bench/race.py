"""Select the tasks of a race and run them, each solver in its own process. A saved race can be resumed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from graspforce import problems
from graspforce.bench.adapter import TOLERANCE
from graspforce.bench.blocks import order_in_blocks
from graspforce.bench.case_sequences import SEQUENCE_COLLECTIONS, case_groups
from graspforce.bench.cluster import conditions_on_cluster, run_tasks_on_cluster
from graspforce.bench.conditions import clock_state, race_conditions
from graspforce.bench.local_workers import run_tasks_here
from graspforce.bench.outcome import RaceOutcome, RaceTask, append, append_clock, drop_partial_line, load, write_header
from graspforce.bench.registry import installed_solvers, load_adapter
from graspforce.core.errors import InvalidInput

UNITS = ("scaled", "si")
SMOKE_PYRAMID_CONTACTS = 100  # some solvers take minutes to read larger pyramids


@dataclass(frozen=True, slots=True)
class RacePlan:
    """Selection of a race.

    Args:
        solvers: names of the registry, or of modules with an adapter.
        settings: accuracy settings, from "default", "high", "low".
        units: units of the programs, from `UNITS`.
        collections: collections of the library; "textbook" stands for its four collections.
        max_cases: maximum number of cases per collection, evenly spaced, sequences kept whole; 0 for all.
        limit: processor time of one solve, s.
        cases: names of the cases instead of those of the collections; empty for the collections.
        pyramid_contacts: largest number of contacts of pyramids that replace exact cones; 0 for no bound.
    """

    solvers: tuple[str, ...]
    settings: tuple[str, ...] = ("default",)
    units: tuple[str, ...] = ("scaled",)
    collections: tuple[str, ...] = ()
    max_cases: int = 40
    limit: float = 2.0
    cases: tuple[str, ...] = ()
    pyramid_contacts: int = 0


def make_race_plan(
    solvers: Sequence[str] = (),
    settings: Sequence[str] = (),
    units: Sequence[str] = (),
    collections: Sequence[str] = (),
    max_cases: int = 40,
    limit: float = 2.0,
    cases: Sequence[str] = (),
) -> RacePlan:
    """Return a race plan after checking all names.

    Args:
        solvers: names of solvers or modules; all installed solvers by default.
        settings: accuracy settings; "default" by default.
        units: units of the programs; "scaled" by default.
        collections: collections of the library; all by default.
        max_cases: maximum number of cases per collection; 0 for all.
        limit: processor time of one solve, s, > 0.
        cases: names of cases, instead of collections and max_cases.

    Raises:
        UnknownName: a solver, a collection or a case is unknown.
        InvalidInput: settings, units, max_cases or limit are not allowed.
    """
    for name in solvers:
        load_adapter(name)
    for name in collections:
        problems.names(name)
    for name in cases:
        problems.text(name)
    for name, allowed, field in [*((s, tuple(TOLERANCE), "settings") for s in settings), *((u, UNITS, "units") for u in units)]:
        if name not in allowed:
            raise InvalidInput(field, name, "one of " + ", ".join(allowed))
    if max_cases < 0:
        raise InvalidInput("max_cases", max_cases, "at least 0 (0: all cases)")
    if not limit > 0:
        raise InvalidInput("limit", limit, "positive, in seconds")
    chosen_solvers = tuple(solvers) or installed_solvers()
    chosen_collections = tuple(collections) or problems.collections()
    chosen_settings, chosen_units = tuple(settings) or ("default",), tuple(units) or ("scaled",)
    return RacePlan(chosen_solvers, chosen_settings, chosen_units, chosen_collections, max_cases, limit, tuple(cases))


def select_cases(collections: Sequence[str], max_cases: int) -> tuple[str, ...]:
    """Return the names of the cases, evenly spaced in each collection, with sequences kept whole.

    Args:
        collections: names of the collections.
        max_cases: maximum number of cases per collection; 0 for all.
    """
    selected: list[str] = []
    for collection in dict.fromkeys(collections):
        groups = case_groups(collection)
        size = max(len(group) for group in groups)
        count = len(groups) if max_cases == 0 else min(len(groups), max(2, round(max_cases / size)))
        selected += [name for i in range(count) for name in groups[i * len(groups) // count]]
    return tuple(dict.fromkeys(selected))


def race_tasks(race: RacePlan) -> Iterator[RaceTask]:
    """Return the tasks of a plan: each solver on each case that it supports, cold, and warm along sequences.

    Args:
        race: the plan.
    """
    names = race.cases or select_cases(race.collections, race.max_cases)
    cases = [(name, problems.load(name).problem) for name in names]
    facts = [(name, len(problem.contacts), problem.cone.type == "pyramid") for name, problem in cases]  # name, size, is pyramid
    bound = race.pyramid_contacts or math.inf
    for solver in race.solvers:
        module = load_adapter(solver)
        for settings in race.settings:
            if settings == "float32" and not getattr(module, "FLOAT32", False):
                continue
            for units in race.units:
                for pyramid in (False, True):
                    for name, contacts, is_pyramid in facts:
                        too_large = pyramid and contacts > bound
                        if too_large or (is_pyramid and not pyramid) or not (module.EXACT_CONES or pyramid):
                            continue
                        yield RaceTask(solver, settings, units, pyramid, False, name)
                        if module.WARM_START and name.partition("/")[0] in SEQUENCE_COLLECTIONS:
                            yield RaceTask(solver, settings, units, pyramid, True, name)


def run(
    race: RacePlan,
    save: Path | None = None,
    progress: Callable[[str, int, int], None] = lambda *_: None,
    cluster: Any = None,
    workers: int = 1,
) -> tuple[dict[str, Any], list[RaceOutcome]]:
    """Run a race, and return its conditions and all outcomes.

    Args:
        race: the plan.
        save: file to which each outcome is appended; tasks whose outcomes it already holds are skipped.
        progress: callback with the last completed task, the number of completed tasks and the number of all tasks.
        cluster: address of a Dask scheduler, or a cluster of Dask; by default this machine runs all tasks.
        workers: number of tasks that run at once on this machine, ≥ 1.

    Raises:
        InvalidInput: the file was written under different conditions.
        BackendError: the cluster cannot be reached, its workers cannot start processes, or their machines or versions differ.
    """
    if workers < 1:
        raise InvalidInput("workers", workers, "at least 1")

    def start(tasks: Sequence[RaceTask]) -> Iterator[RaceOutcome]:
        if cluster is None:
            return run_tasks_here(tasks, race.limit, workers)
        return run_tasks_on_cluster(tasks, race.limit, cluster, facts)

    here = cluster is None
    facts = race_conditions(race.solvers, race.limit) if here else conditions_on_cluster(race.solvers, race.limit, cluster)
    tasks = list(race_tasks(race))
    if workers > 1 and cluster is None:
        tasks = order_in_blocks(tasks)
    return run_tasks(tasks, facts, start, save, progress, workers)


def run_tasks(
    tasks: Sequence[RaceTask],
    facts: dict[str, Any],
    start: Callable[[Sequence[RaceTask]], Iterator[RaceOutcome]],
    save: Path | None = None,
    progress: Callable[[str, int, int], None] = lambda *_: None,
    workers: int = 1,
) -> tuple[dict[str, Any], list[RaceOutcome]]:
    """Run the tasks that a file does not hold yet, and return the conditions and all outcomes in the order of the tasks.

    Args:
        tasks: the tasks.
        facts: conditions of the race, as `race_conditions` returns them.
        start: function that yields the outcomes of tasks; it may end early.
        save: file to which each outcome is appended; tasks whose outcomes it already holds are skipped.
        progress: callback with the last completed task, the number of completed tasks and the number of all tasks.
        workers: number of tasks that run at once, for the record.

    Raises:
        InvalidInput: the file was written under different conditions.
    """
    known: dict[RaceTask, RaceOutcome] = {}
    earlier_clocks: list[Any] = []
    if save is not None and save.exists():
        known, earlier_clocks = _earlier_outcomes(save, facts)
    elif save is not None:
        write_header(save, facts)
    missing = [task for task in tasks if task not in known]
    done, before_race, begin = len(tasks) - len(missing), clock_state(), time.monotonic()
    clocks: list[dict[str, Any]] = []
    progress("", done, len(tasks))
    try:
        for outcome in start(missing):
            task = outcome.task
            known[task] = outcome
            if save is not None:
                append(save, outcome)
            done += 1
            progress(f"{task.solver} {task.settings} {task.units} {task.case}", done, len(tasks))
    finally:
        if missing:
            elapsed = round(time.monotonic() - begin, 1)  # s
            clocks = [{"before": before_race, "after": clock_state(), "workers": workers, "seconds": elapsed}]
            if save is not None:
                append_clock(save, clocks[0])
    return {**facts, "clocks": [*earlier_clocks, *clocks]}, [known[task] for task in tasks if task in known]


def _earlier_outcomes(save: Path, facts: dict[str, Any]) -> tuple[dict[RaceTask, RaceOutcome], list[Any]]:
    """Return the outcomes and clock rates of a saved race, after checking that its conditions are the same."""
    before, outcomes = load(save)
    different = [name for name in facts if before.get(name) != facts[name] and name != "versions"]
    different += [name for name, own in facts["versions"].items() if before["versions"].get(name, own) != own]
    if different:
        allowed = f"a new file, or one with the same conditions; this one was made with another {different[0]}"
        raise InvalidInput("save", str(save), allowed)
    drop_partial_line(save)
    return {outcome.task: outcome for outcome in outcomes}, before.get("clocks", [])
