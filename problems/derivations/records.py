"""Build the records of case files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

Record = dict[str, Any]

SCHEMA = "graspforce/problem/1"
CLOSED_FORM = 1e-7  # relative: tolerance of exact answers, for solvers that stop at 1e-8


def contact_record(position: Sequence[float], normal: Sequence[float], **more: Any) -> Record:
    """Return the record of a contact; ``more`` holds further fields of a problem file."""
    return {"position": list(position), "normal": list(normal), **more}


def case_record(
    name: str,
    source: str,
    contacts: list[Record],
    wrench: Sequence[float],
    expected: Record,
    *,
    objective: str | Record,
    cone: tuple[str, int] | None = None,
    hand: Record | None = None,
) -> Record:
    """Return the record of a case file.

    Args:
        name: ``collection/case``.
        source: origin of the problem, and derivation of the answer.
        contacts: records of the contacts, as in a problem file.
        wrench: (6,) wrench that the contacts must supply, N and N·m.
        expected: `expected_optimum` or `expected_infeasibility`.
        objective: type of the objective, or its record.
        cone: side and facets of a pyramid; None for the exact cone.
        hand: record of the actuation, as in a problem file.
    """
    record: Record = {"schema": SCHEMA, "name": name, "source": source, "contacts": contacts, "wrench": list(wrench)}
    if hand is not None:
        record["hand"] = hand
    if cone is not None:
        record["cone"] = {"type": "pyramid", "facets": cone[1], "side": cone[0]}
    record["objective"] = {"type": objective} if isinstance(objective, str) else objective
    record["expected"] = expected
    return _rounded(record)  # type: ignore[no-any-return]


def expected_optimum(objective: float, normals: Sequence[float] | None = None, tolerance: float = CLOSED_FORM) -> Record:
    """Return the ``expected`` record of a feasible problem."""
    record: Record = {"status": "optimal", "objective": objective, "tolerance": tolerance}
    return record if normals is None else {**record, "normals": list(normals)}


def expected_infeasibility(proof: Record, tolerance: float = CLOSED_FORM, **factors: float) -> Record:
    """Return the ``expected`` record of an infeasible problem."""
    return {"status": "infeasible", "proof": proof, "tolerance": tolerance, **factors}


def _rounded(value: Any) -> Any:
    """Round numbers to 15 digits, because sines differ between machines beyond that; return 0 below 1e-15."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    if isinstance(value, float):
        near = float(f"{value:.15g}")
        return 0.0 if abs(near) < 1e-15 else near
    return value
