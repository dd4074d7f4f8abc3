"""Build the records of generated problems, with numbers rounded to nine digits to keep files short."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from graspforce.contact.contact import Contact, ContactModel, ContactSet
from graspforce.contact.matrices import grasp_matrix
from graspforce.core.arrays import Array
from graspforce.hand.actuation import Actuation
from graspforce.problems.derivations.records import SCHEMA, Record, contact_record

_DIGITS = 9


def problem_record(
    name: str,
    source: str,
    contacts: list[Record],
    wrench: Array | Sequence[float],
    *,
    objective: str | Record,
    hand: Record | None = None,
    cone: tuple[str, int] | None = None,
    expected: Record | None = None,
) -> Record:
    """Return the record of a problem, as `graspforce.problems.derivations.records.case_record` does, with an optional answer.

    Args:
        name: ``collection/case``.
        source: origin of the problem.
        contacts: records of the contacts, from `rounded_contact` or as in a problem file.
        wrench: (6,) wrench that the contacts must supply, N and N·m; not rounded, because it must stay in the range of G.
        objective: type of the objective, or its record.
        hand: record of the actuation, from `rounded_hand`.
        cone: side and facets of a pyramid; None for the exact cone.
        expected: record of the answer, if the construction proves it.
    """
    record: Record = {"schema": SCHEMA, "name": name, "source": source, "contacts": contacts}
    record["wrench"] = np.asarray(wrench, dtype=np.float64).tolist()
    if hand is not None:
        record["hand"] = hand
    if cone is not None:
        record["cone"] = {"type": "pyramid", "facets": cone[1], "side": cone[0]}
    record["objective"] = {"type": objective} if isinstance(objective, str) else objective
    return record if expected is None else {**record, "expected": expected}


def round_numbers(values: Any) -> Any:
    """Round numbers, or nested lists of numbers, to nine digits; integral values become integers."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if isinstance(values, list | tuple):
        return [round_numbers(value) for value in values]
    if isinstance(values, float):
        near = float(f"{values:.{_DIGITS}g}")
        return int(near) if near.is_integer() and abs(near) < 10**_DIGITS else near
    return values


def rounded_contact(position: Any, normal: Any, **more: Any) -> Record:
    """Return the record of a contact; ``more`` holds further fields of a problem file."""
    numbers = {
        name: round_numbers(float(value)) if isinstance(value, float | np.floating) else value for name, value in more.items()
    }
    return contact_record(round_numbers(position), round_numbers(normal), **numbers)


def rounded_contacts(contacts: ContactSet) -> list[Record]:
    """Return the records of contacts whose frames follow the default rule."""
    records = []
    for one in contacts.contacts:
        more = {name: getattr(one, name) for name in ("friction", "torsional_friction", "max_normal")}
        more = {name: value for name, value in more.items() if value is not None}
        if one.model is not ContactModel.POINT:
            more["model"] = one.model.value
        if one.min_normal:
            more["min_normal"] = one.min_normal
        records.append(rounded_contact(one.position, one.normal, **more))
    return records


def rounded_hand(actuation: Actuation, *, weighted: bool = True) -> Record:
    """Return the record of an actuation; unit weights are omitted."""
    record: Record = {name: round_numbers(value) for name, value in actuation.to_dict().items()}
    if not weighted:
        record.pop("torque_weight", None)
    return record


def contact_set(contacts: Sequence[Record]) -> ContactSet:
    """Return the contacts of records."""
    return ContactSet.stack([Contact.from_dict(one) for one in contacts])


def supplied_wrench(contacts: Sequence[Record], f: Array) -> Array:
    """Return the (6,) wrench G f of stacked forces at the contacts of the records, N and N·m."""
    return np.asarray(grasp_matrix(contact_set(contacts)) @ f)
