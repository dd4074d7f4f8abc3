"""Merge the outcome files of a race that ran in parts, on one or several machines, and pack them into one compressed file.

A packed file is an outcome file, compressed (``.jsonl.xz``). Its header has ``sessions`` instead of one machine: the machine,
the clock rates, and the number of tasks of each solver. Times keep four digits and residuals three.
"""

from __future__ import annotations

import dataclasses
import json
import lzma
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from graspforce.bench.outcome import SCHEMA, RaceOutcome, RaceTask, load
from graspforce.core.errors import InvalidInput

_MACHINE = ("machine", "cores", "python")
_COMMON = ("limit", "problems")  # equal in all parts
_PACKAGES = ("graspforce", "numpy", "scipy")  # whose versions count beside those of the solvers


def merge_races(paths: Iterable[Path]) -> tuple[dict[str, Any], list[RaceOutcome]]:
    """Return the conditions and outcomes of several outcome files. Of tasks in two files, the first file counts.

    Args:
        paths: outcome files, packed or not; at least one.

    Raises:
        InvalidInput: a file is not an outcome file, or has another limit, other problem data or another version of a solver.
    """
    merged: dict[RaceTask, RaceOutcome] = {}
    common: dict[str, Any] = {}
    versions: dict[str, str] = {}
    sessions: list[dict[str, Any]] = []
    for path in paths:
        conditions, outcomes = load(path)
        own = {name: conditions.get(name) for name in _COMMON}
        common = common or own
        new = [outcome for outcome in outcomes if outcome.task not in merged]
        used = {outcome.task.solver for outcome in new}
        given = {name: version for name, version in conditions["versions"].items() if name in used or name in _PACKAGES}
        different = [name for name in _COMMON if own[name] != common[name]]
        different += [f"version of {name}" for name, version in given.items() if versions.get(name, version) != version]
        if different:
            raise InvalidInput("file", str(path), f"a part of the same race; this one has another {different[0]}")
        versions |= given
        merged |= {outcome.task: outcome for outcome in new}
        sessions += _sessions(conditions, new)
    if not common:
        raise InvalidInput("files", [], "at least one outcome file")
    return {**common, "versions": versions, "sessions": _joined(sessions)}, list(merged.values())


def pack(path: Path, conditions: Mapping[str, Any], outcomes: Sequence[RaceOutcome]) -> None:
    """Write a packed file, with its outcomes sorted by task.

    Args:
        path: file that ends in ``.jsonl.xz``.
        conditions: conditions from `merge_races`.
        outcomes: the outcomes.

    Raises:
        InvalidInput: the file has another ending.
    """
    if path.suffix != ".xz":
        raise InvalidInput("file", str(path), "a file that ends in .jsonl.xz")
    ordered = sorted(outcomes, key=lambda one: dataclasses.astuple(one.task))
    lines = [{"schema": SCHEMA, **conditions}, *(_rounded(outcome.to_dict()) for outcome in ordered)]
    text = "".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(lzma.compress(text.encode(), preset=9))


def _rounded(record: dict[str, Any]) -> dict[str, Any]:
    """Return a record with fewer digits."""
    digits = {"residual": 3, "seconds": 4, "cold": 4}
    short = {key: float(f"{record[key]:.{n}g}") for key, n in digits.items() if record[key] is not None}
    return {**record, **short}


def _sessions(conditions: Mapping[str, Any], outcomes: Sequence[RaceOutcome]) -> list[dict[str, Any]]:
    """Return the sessions of a file: those of its header, or one for its machine."""
    if "sessions" in conditions:
        return list(conditions["sessions"])
    tasks = dict(Counter(outcome.task.solver for outcome in outcomes))
    facts = {name: conditions[name] for name in _MACHINE}
    return [{**facts, "clocks": conditions.get("clocks", []), "tasks": tasks}] if tasks else []


def _joined(sessions: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return one session for each machine."""
    machines: dict[tuple[Any, ...], dict[str, Any]] = {}
    for session in sessions:
        key = tuple(session[name] for name in _MACHINE)
        one = machines.setdefault(key, {**dict(zip(_MACHINE, key, strict=True)), "clocks": [], "tasks": {}})
        one["clocks"] = [*one["clocks"], *session["clocks"]]
        one["tasks"] = dict(Counter(one["tasks"]) + Counter(session["tasks"]))
    return list(machines.values())
