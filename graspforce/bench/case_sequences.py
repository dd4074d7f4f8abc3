"""Cases that form sequences, for warm starts."""

from __future__ import annotations

from itertools import groupby

from graspforce import problems

SEQUENCE_COLLECTIONS = ("closed-loop", "trajectory")  # collections whose cases form sequences


def sequence_name(name: str) -> str:
    """Return the sequence of a case: its name without the last number.

    Args:
        name: name of the case.
    """
    return name.rpartition("-")[0]


def previous_case(name: str) -> str | None:
    """Return the previous case of a sequence; None for the first.

    Args:
        name: name of the case.
    """
    names = problems.names(name.partition("/")[0])
    i = names.index(name)
    return names[i - 1] if i and sequence_name(names[i - 1]) == sequence_name(name) else None


def case_groups(collection: str) -> list[list[str]]:
    """Return the cases of a collection in groups that a race keeps together: whole sequences, or single cases.

    Args:
        collection: name of the collection.

    Raises:
        UnknownName: no collection has that name.
    """
    names = problems.names(collection)
    if collection in SEQUENCE_COLLECTIONS:
        return [list(group) for _, group in groupby(names, key=sequence_name)]
    return [[name] for name in names]
