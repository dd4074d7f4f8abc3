"""Answers-only track: judge the answers of a solver from a file, without running the solver. Their times are reported ones.

A file has one answer per row: Parquet, JSON (a list of records) or CSV (numbers of a list separated by spaces). Its columns:

    case         name of a case of the library
    cone         "exact" (default), or "pyramid": exact cones replaced by inner pyramids of `FACETS` facets
    settings     requested accuracy: a key of `TOLERANCE` (default: "default")
    status       "solved", "infeasible" or "no answer"
    x            variables of the case's program, as `case_program` and the data package state it; empty unless solved
    y, z         its multipliers, or a ray if infeasible: P x + q = Aᵀ y − Cᵀ z − …; both empty for a solver without multipliers
    seconds      time that the author reports, s; may be empty
    iterations   number of iterations; may be empty
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from graspforce.bench.adapter import TOLERANCE, SolverStatus, make_result
from graspforce.bench.case_program import case_program
from graspforce.bench.judge import judge
from graspforce.bench.outcome import RaceOutcome, RaceTask
from graspforce.bench.worker import load_proven_case
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.optional_libraries import optional_imports

_COLUMNS = ("case", "status", "cone", "settings", "x", "y", "z", "seconds", "iterations")
_STATUSES = tuple(status.value for status in SolverStatus)


@dataclass(frozen=True, eq=False, slots=True)
class ReportedAnswer:
    """One answer of a file; the module describes its fields.

    Args:
        case: name of the case.
        pyramid: whether exact cones were replaced by inner pyramids.
        settings: requested accuracy.
        status: status that the solver returned.
        x: variables, or None.
        y: multipliers of the equations, or None.
        z: multipliers of the inequalities, or None.
        seconds: reported time, s, or None.
        iterations: reported number of iterations.
    """

    case: str
    pyramid: bool
    settings: str
    status: SolverStatus
    x: Array | None
    y: Array | None
    z: Array | None
    seconds: float | None
    iterations: int


def load_answers(path: Path) -> tuple[ReportedAnswer, ...]:
    """Return the answers of a file.

    Args:
        path: file that ends in .parquet, .json or .csv.

    Raises:
        InvalidInput: the file has another ending, no rows, or a value that is not allowed; the error names row and column.
        MissingLibrary: a Parquet file without pyarrow.
    """
    readers = {".parquet": _parquet_rows, ".json": _json_rows, ".csv": _csv_rows}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InvalidInput("answers", str(path), "a file that ends in " + ", ".join(readers))
    rows = list(reader(path))
    if not rows:
        raise InvalidInput("answers", str(path), "a file with at least one row")
    return tuple(_answer(row, f"rows[{i}]") for i, row in enumerate(rows))


def judge_answers(solver: str, answers: Sequence[ReportedAnswer]) -> tuple[RaceOutcome, ...]:
    """Return the outcomes of answers, judged by the certificate and the proven optima.

    Args:
        solver: name of the solver in tables.
        answers: its answers.

    Raises:
        UnknownName: a case is not in the library.
        InvalidInput: a vector does not have the size of its program.
    """
    return tuple(_outcome(solver, answer, f"rows[{i}]") for i, answer in enumerate(answers))


def check_unique(answers: Sequence[ReportedAnswer]) -> None:
    """Check that no case, cone and settings has two answers, which would count twice.

    Args:
        answers: the answers.

    Raises:
        InvalidInput: two answers are for the same case, cone and settings.
    """
    first: dict[tuple[str, bool, str], int] = {}
    for i, answer in enumerate(answers):
        earlier = first.setdefault((answer.case, answer.pyramid, answer.settings), i)
        if earlier != i:
            raise InvalidInput(
                f"rows[{i}].case", answer.case, f"the only answer for its cone and settings; see rows[{earlier}]"
            )


def _outcome(solver: str, answer: ReportedAnswer, path: str) -> RaceOutcome:
    problem, feasible, optimum = load_proven_case(answer.case, answer.pyramid)
    program = case_program(problem)
    sizes = {"x": len(program.q), "y": len(program.b), "z": len(program.d)}
    for name, size in sizes.items():
        value = getattr(answer, name)
        if value is not None and len(value) != size:
            raise InvalidInput(f"{path}.{name}", f"{len(value)} numbers", f"{size} numbers, as the program of {answer.case}")
    z = np.zeros(0) if answer.y is not None and answer.z is None and not len(program.d) else answer.z
    result = make_result(program, answer.status, answer.x, answer.y, z, answer.iterations)
    judgement = judge(problem, feasible, result, answer.settings, optimum)
    task = RaceTask(solver, answer.settings, "scaled", answer.pyramid, False, answer.case)
    seconds = answer.seconds if judgement.is_solved else None
    contacts = len(problem.contacts)
    return RaceOutcome(task, contacts, feasible, judgement, seconds, None, answer.iterations, time_is_reported=True)


def _answer(row: Mapping[str, Any], path: str) -> ReportedAnswer:
    """Return the answer of a row; empty values count as missing."""
    given = {name: value for name, value in row.items() if value is not None and value != "" and np.size(value)}
    optional = [name for name in _COLUMNS if name not in ("case", "status")]
    values = fields.check_record(given, path, required=["case", "status"], optional=optional)
    status = SolverStatus(fields.check_choice(values["status"], f"{path}.status", _STATUSES))
    cone = fields.check_choice(values.get("cone", "exact"), f"{path}.cone", ("exact", "pyramid"))
    settings = fields.check_choice(values.get("settings", "default"), f"{path}.settings", tuple(TOLERANCE))
    x, y, z = (_vector(values.get(name), f"{path}.{name}") for name in "xyz")
    seconds = values.get("seconds")
    time = None if seconds is None else arrays.check_number(seconds, f"{path}.seconds", above=0.0)
    iterations = int(arrays.check_number(values.get("iterations", 0), f"{path}.iterations", minimum=0.0))
    return ReportedAnswer(values["case"], cone == "pyramid", settings, status, x, y, z, time, iterations)


def _vector(value: Any, path: str) -> Array | None:
    return None if value is None else arrays.check_array(value, path, (None,))


def _parquet_rows(path: Path) -> list[dict[str, Any]]:
    with optional_imports():
        import pyarrow.parquet
    return list(pyarrow.parquet.read_table(path).to_pylist())


def _json_rows(path: Path) -> Iterable[Mapping[str, Any]]:
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InvalidInput("answers", str(path), f"a list of records in JSON ({error})") from None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InvalidInput("answers", str(path), "a list of records in JSON")
    return rows


def _csv_rows(path: Path) -> Iterable[dict[str, Any]]:
    with path.open(encoding="utf-8", newline="") as file:
        for i, row in enumerate(csv.DictReader(file)):
            yield {name: _csv_value(name, text, f"rows[{i}].{name}") for name, text in row.items() if name is not None}


def _csv_value(name: str, text: str | None, path: str) -> Any:
    if not text or name not in ("x", "y", "z", "seconds", "iterations"):
        return text
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        raise InvalidInput(path, text[:40], "numbers separated by spaces") from None
    return numbers if name in "xyz" else numbers[0]
