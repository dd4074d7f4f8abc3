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
from graspforce.bench.entrant import TOLERANCE
from graspforce.bench.outcome import Outcome, Task, append, load, mend, save_header
from graspforce.bench.registry import entrant, installed, version
from graspforce.bench.worker import Worker, sequence
from graspforce.errors import InvalidInput

UNITS = ("scaled", "si")
SEQUENCES = "trajectory"  # the collection whose cases follow one another
LARGEST_PYRAMID = 100  # contacts: beyond, dense programs of 8 facets a contact take minutes for every solver
LARGEST_CONE = 300  # contacts: beyond, dense cone programs do; the structured kernel goes on, which makes none
_UNBOUNDED = "structured"


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be raced.

    Args:
        solvers: names of the registry, or modules.
        settings: of "default", "high", "low".
        units: of `UNITS`.
        collections: of the library; "textbook" stands for its four.
        most: cases of a collection at most, evenly through it, whole sequences where it has them; 0 for all.
        limit: s, for one solve.
    """

    solvers: tuple[str, ...]
    settings: tuple[str, ...] = ("default",)
    units: tuple[str, ...] = ("scaled",)
    collections: tuple[str, ...] = ()
    most: int = 40
    limit: float = 2.0


def plan(
    solvers: Sequence[str] = (),
    settings: Sequence[str] = (),
    units: Sequence[str] = (),
    collections: Sequence[str] = (),
    most: int = 40,
    limit: float = 2.0,
) -> Plan:
    """A plan whose names are all known; what is not given has its default, which is everything but settings and units.

    Raises:
        UnknownName: no such solver or collection.
        InvalidInput: settings, units, most or limit that are not allowed.
    """
    for name in solvers:
        entrant(name)
    for name in collections:
        problems.names(name)
    for name, allowed, field in [*((s, tuple(TOLERANCE), "settings") for s in settings), *((u, UNITS, "units") for u in units)]:
        if name not in allowed:
            raise InvalidInput(field, name, "one of " + ", ".join(allowed))
    if most < 0:
        raise InvalidInput("most", most, "0 for all, or a whole number above")
    if not limit > 0:
        raise InvalidInput("limit", limit, "seconds, above 0")
    every = tuple(solvers) or installed()
    where = tuple(collections) or problems.collections()
    return Plan(every, tuple(settings) or ("default",), tuple(units) or ("scaled",), where, most, limit)


def chosen(collections: Sequence[str], most: int) -> tuple[str, ...]:
    """The names of the cases: at most so many of a collection, evenly through it, whole sequences where it has them."""
    found: list[str] = []
    for collection in dict.fromkeys(collections):
        names = problems.names(collection)
        groups = [list(group) for _, group in groupby(names, key=sequence)] if collection == SEQUENCES else [[n] for n in names]
        size = max(len(group) for group in groups)
        count = len(groups) if most == 0 else min(len(groups), max(2, round(most / size)))
        found += [name for i in range(count) for name in groups[i * len(groups) // count]]
    return tuple(dict.fromkeys(found))


def tasks(race: Plan) -> Iterator[Task]:
    """What the plan comes to: every solver on every case that it takes, cold, and along sequences warm as well."""
    cases = [(name, problems.load(name).problem) for name in chosen(race.collections, race.most)]
    facts = [(name, len(problem.contacts), problem.cone.type == "pyramid") for name, problem in cases]
    for solver in race.solvers:
        module = entrant(solver)
        for settings in race.settings:
            for units in race.units:
                for pyramid in (False, True):
                    for name, contacts, native in facts:
                        largest = LARGEST_PYRAMID if pyramid else LARGEST_CONE
                        too_large = contacts > largest and not (solver == _UNBOUNDED and not pyramid)
                        if too_large or (native and not pyramid) or not (module.EXACT or pyramid):
                            continue
                        yield Task(solver, settings, units, pyramid, False, name)
                        if module.WARM and name.startswith(f"{SEQUENCES}/"):
                            yield Task(solver, settings, units, pyramid, True, name)


def run(
    race: Plan, save: Path | None = None, progress: Callable[[str, int, int], None] = lambda *_: None
) -> tuple[dict[str, Any], list[Outcome]]:
    """Race, and return the conditions and all outcomes.

    Args:
        race: what is to be raced.
        save: a file for the outcomes, written one by one; where it exists already, what it holds is not run again.
        progress: told what is run, how many tasks are done, and of how many.

    Raises:
        InvalidInput: the file was made under other conditions.
    """
    facts = conditions(race)
    known: dict[Task, Outcome] = {}
    if save is not None and save.exists():
        before, outcomes = load(save)
        different = [name for name in facts if before.get(name) != facts[name] and name != "versions"]
        different += [name for name, own in facts["versions"].items() if before["versions"].get(name, own) != own]
        if different:
            raise InvalidInput("save", str(save), f"a new file: this one was made with another {different[0]}")
        mend(save)
        known = {outcome.task: outcome for outcome in outcomes}
    elif save is not None:
        save_header(save, facts)
    wanted = list(tasks(race))
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


def conditions(race: Plan) -> dict[str, Any]:
    """What the times depend on: machine, versions, limit."""
    versions = {"graspforce": graspforce.__version__, **{solver: version(solver) for solver in race.solvers}}
    return {"machine": processor(), "cores": os.cpu_count(), "python": platform.python_version(), "limit": race.limit} | {
        "versions": versions
    }


def processor() -> str:
    """The processor's own name, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
