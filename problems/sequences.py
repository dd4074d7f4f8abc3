"""Sequences of cases, stored compactly: the first case in full, and of each other case only the fields that differ.

A file ``sequences.jsonl`` has one sequence on each line:

    {"name": "closed-loop/ideal-01", "first": {case without name}, "steps": [{}, {"wrench": […], "expected": {…}}, …]}

The case ``closed-loop/ideal-01-007`` is the first case, changed by the eighth step. A change replaces values; it is applied
to each item of a list of records, such as the contacts. ``{"=": …}`` replaces records whose fields differ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from graspforce.problems.derivations.records import Record
from graspforce.problems.json_format import format_case_line

_REPLACED = "="
_DIGITS = 3  # of the number of a step in the name of its case


def step_name(sequence: str, step: int) -> str:
    """Return the name of a case of a sequence.

    Args:
        sequence: name of the sequence, ``collection/sequence``.
        step: index of the case, from 0.
    """
    return f"{sequence}-{step:0{_DIGITS}}"


def format_sequence(sequence: str, cases: Sequence[Record]) -> str:
    """Return the line of a sequence.

    Args:
        sequence: name of the sequence.
        cases: records of its cases, in order; their names are not stored.
    """
    nameless = [{key: value for key, value in case.items() if key != "name"} for case in cases]
    steps = [find_changes(nameless[0], case) for case in nameless]
    return format_case_line({"name": sequence, "first": nameless[0], "steps": steps})


def find_changes(first: Record, case: Record) -> Record:
    """Return the fields of a case that differ from those of the first; nested records are compared field by field.

    Args:
        first: record of the first case.
        case: record with the same fields.

    Raises:
        ValueError: the records have different fields.
    """
    if first.keys() != case.keys():
        raise ValueError(f"fields differ: {sorted(first.keys() ^ case.keys())}")
    changes: Record = {}
    for key, value in case.items():
        before = first[key]
        if value == before:
            continue
        if _are_alike(value, before):
            changes[key] = find_changes(before, value)
        elif _are_records(value) and _are_records(before) and all(map(_are_alike, value, before)) and len(value) == len(before):
            changes[key] = [find_changes(*pair) for pair in zip(before, value, strict=True)]
        else:
            changes[key] = {_REPLACED: value} if isinstance(value, Mapping) or _are_records(value) else value
    return changes


def apply_changes(first: Mapping[str, Any], changes: Mapping[str, Any]) -> Record:
    """Return the first case with the changes of a step.

    Args:
        first: record of the first case.
        changes: fields that differ, from `find_changes`.
    """
    changed = dict(first)
    for key, value in changes.items():
        before = first[key]
        if isinstance(value, Mapping):
            changed[key] = value[_REPLACED] if _REPLACED in value else apply_changes(before, value)
        elif _are_records(value):
            changed[key] = [apply_changes(*pair) for pair in zip(before, value, strict=True)]
        else:
            changed[key] = value
    return changed


def _are_alike(value: Any, before: Any) -> bool:
    """Return whether both are records with the same fields."""
    return isinstance(value, Mapping) and isinstance(before, Mapping) and value.keys() == before.keys()


def _are_records(value: Any) -> bool:
    """Return whether a value is a list of records."""
    return isinstance(value, list) and bool(value) and all(isinstance(item, Mapping) for item in value)
