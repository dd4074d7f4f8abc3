"""Which solvers run on which cases, and running them: each in a process of its own, one after another, resumable."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import graspforce
from graspforce import problems
from graspforce.bench.adapter import TOLERANCE
from graspforce.bench.outcome import RaceOutcome, RaceTask, append, drop_partial_line, load, write_header
from graspforce.bench.registry import installed_solvers, load_adapter, version
from graspforce.bench.worker import Worker, sequence_name
from graspforce.core.errors import InvalidInput

UNITS = ("scaled", "si")
SEQUENCE_COLLECTION = "trajectory"  # the collection whose cases follow one another
MAX_PYRAMID_CONTACTS = 100  # contacts: beyond, dense programs of 8 facets a contact take minutes for every solver
MAX_CONE_CONTACTS = 300  # contacts: beyond, dense cone programs do; the structured kernel goes on, which makes none
_UNLIMITED_SOLVER = "structured"


@dataclass(frozen=True, slots=True)
class RacePlan:
    """What is to be raced.

    Args:
        solvers: names of the registry, or modules.
        settings: of "default", "high", "low".
        units: of `UNITS`.
        collections: of the library; "textbook" stands for its four.
        max_cases: cases of a collection at most, evenly through it, whole sequences where it has them; 0 for all.
        limit: s, for one solve.
    """

    solvers: tuple[str, ...]
    settings: tuple[str, ...] = ("default",)
    units: tuple[str, ...] = ("scaled",)
    collections: tuple[str, ...] = ()
    max_cases: int = 40
    limit: float = 2.0


def make_race_plan(
    solvers: Sequence[str] = (),
    settings: Sequence[str] = (),
    units: Sequence[str] = (),
    collections: Sequence[str] = (),
    max_cases: int = 40,
    limit: float = 2.0,
) -> RacePlan:
    """Return a race plan with all names checked; the defaults include everything but settings and units.

    Raises:
        UnknownName: no such solver or collection.
        InvalidInput: settings, units, max_cases or limit that are not allowed.
    """
    for name in solvers:
        load_adapter(name)
    for name in collections:
        problems.names(name)
    for name, allowed, field in [*((s, tuple(TOLERANCE), "settings") for s in settings), *((u, UNITS, "units") for u in units)]:
        if name not in allowed:
            raise InvalidInput(field, name, "one of " + ", ".join(allowed))
    if max_cases < 0:
        raise InvalidInput("max_cases", max_cases, "0 for all, or a whole number above")
    if not limit > 0:
        raise InvalidInput("limit", limit, "seconds, above 0")
    every = tuple(solvers) or installed_solvers()
    where = tuple(collections) or problems.collections()
    return RacePlan(every, tuple(settings) or ("default",), tuple(units) or ("scaled",), where, max_cases, limit)


def select_cases(collections: Sequence[str], max_cases: int) -> tuple[str, ...]:
    """Return the names of the cases, evenly spaced in each collection; sequences stay whole."""
    found: list[str] = []
    for collection in dict.fromkeys(collections):
        names = problems.names(collection)
        groups = (
            [list(group) for _, group in groupby(names, key=sequence_name)]
            if collection == SEQUENCE_COLLECTION
            else [[n] for n in names]
        )
        size = max(len(group) for group in groups)
        count = len(groups) if max_cases == 0 else min(len(groups), max(2, round(max_cases / size)))
        found += [name for i in range(count) for name in groups[i * len(groups) // count]]
    return tuple(dict.fromkeys(found))


def race_tasks(race: RacePlan) -> Iterator[RaceTask]:
    """Return the tasks of a plan: each solver on each case that it supports, cold, and warm along sequences."""
    cases = [(name, problems.load(name).problem) for name in select_cases(race.collections, race.max_cases)]
    facts = [(name, len(problem.contacts), problem.cone.type == "pyramid") for name, problem in cases]
    for solver in race.solvers:
        module = load_adapter(solver)
        for settings in race.settings:
            for units in race.units:
                for pyramid in (False, True):
                    for name, contacts, native in facts:
                        largest = MAX_PYRAMID_CONTACTS if pyramid else MAX_CONE_CONTACTS
                        too_large = contacts > largest and not (solver == _UNLIMITED_SOLVER and not pyramid)
                        if too_large or (native and not pyramid) or not (module.EXACT_CONES or pyramid):
                            continue
                        yield RaceTask(solver, settings, units, pyramid, False, name)
                        if module.WARM_START and name.startswith(f"{SEQUENCE_COLLECTION}/"):
                            yield RaceTask(solver, settings, units, pyramid, True, name)


def run(
    race: RacePlan, save: Path | None = None, progress: Callable[[str, int, int], None] = lambda *_: None
) -> tuple[dict[str, Any], list[RaceOutcome]]:
    """Race, and return the conditions and all outcomes.

    Args:
        race: what is to be raced.
        save: a file for the outcomes, written one by one; where it exists already, what it holds is not run again.
        progress: told what is run, how many tasks are done, and of how many.

    Raises:
        InvalidInput: the file was made under other conditions.
    """
    facts = race_conditions(race)
    known: dict[RaceTask, RaceOutcome] = {}
    if save is not None and save.exists():
        before, outcomes = load(save)
        different = [name for name in facts if before.get(name) != facts[name] and name != "versions"]
        different += [name for name, own in facts["versions"].items() if before["versions"].get(name, own) != own]
        if different:
            raise InvalidInput("save", str(save), f"a new file: this one was made with another {different[0]}")
        drop_partial_line(save)
        known = {outcome.task: outcome for outcome in outcomes}
    elif save is not None:
        write_header(save, facts)
    wanted = list(race_tasks(race))
    done = 0
    results = []
    for solver, own in groupby(wanted, key=lambda task: task.solver):
        with Worker(race.limit) as worker:
            for task in own:
                progress(f"{solver} {task.settings} {task.units} {task.case}", done, len(wanted))
                outcome = known.get(task) or worker.run(task)
                if task not in known and save is not None:
                    append(save, outcome)
                results.append(outcome)
                done += 1
    progress("done", done, len(wanted))
    return facts, results


def race_conditions(race: RacePlan) -> dict[str, Any]:
    """Return the conditions that times depend on: machine, versions, limit."""
    versions = {"graspforce": graspforce.__version__, **{solver: version(solver) for solver in race.solvers}}
    return {"machine": processor(), "cores": os.cpu_count(), "python": platform.python_version(), "limit": race.limit} | {
        "versions": versions
    }


def processor() -> str:
    """Return the name of the processor, if the system provides it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
