"""Tasks and outcomes of a race, and the outcome file: a header line, then one JSON record per line.

A record is an outcome, or ``{"clock": …}``, the clock rates before and after one session of the race. A file that ends in
``.xz`` is compressed.
"""

from __future__ import annotations

import json
import lzma
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from graspforce.bench.judge import Judgement, Verdict
from graspforce.core.errors import InvalidInput

SCHEMA = "graspforce/bench/4"
_OLDER_SCHEMAS = ("graspforce/bench/3", "graspforce/bench/2")  # without verdicts on forces alone; 2: four names differ
_OLDER_VERDICTS = {"lied": "wrong", "gave up": "no answer", "stopped": "timed out", "refused": "unsupported"}


@dataclass(frozen=True, slots=True)
class RaceTask:
    """One run of a solver on a case.

    Args:
        solver: name of the solver, or of a module with an adapter.
        settings: accuracy settings: "default", "high" or "low".
        units: units of the program: "scaled" (units of the problem) or "si".
        pyramid: whether exact cones are replaced by inner pyramids of `FACETS` facets.
        warm: whether the run starts from the solver's cold solution of the previous case in the sequence.
        case: name of the case in the library.
    """

    solver: str
    settings: str
    units: str
    pyramid: bool
    warm: bool
    case: str


@dataclass(frozen=True, slots=True)
class RaceOutcome:
    """Outcome of a task.

    Args:
        task: the task.
        contacts: number of contacts of the case.
        feasible: proven feasibility of the case.
        judgement: worst judgement of all runs of the task.
        seconds: time of set-up and solve, s: median of several cold runs, or one warm run; None unless solved.
        cold: time of a cold run just before the warm run, s; None for cold tasks and without a previous solution.
        iterations: number of iterations that the solver reports, in its first run.
        verdict_varies: whether runs of the task got different verdicts.
        time_is_reported: whether the author of the solver reports the time, which was then not measured here.
    """

    task: RaceTask
    contacts: int
    feasible: bool
    judgement: Judgement
    seconds: float | None
    cold: float | None
    iterations: int
    verdict_varies: bool = False
    time_is_reported: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return the record of one line of the outcome file."""
        record = {**asdict(self.task), "contacts": self.contacts, "feasible": self.feasible}
        record |= {"verdict": self.judgement.verdict.value, "residual": self.judgement.residual}
        record |= {"seconds": self.seconds, "cold": self.cold, "iterations": self.iterations, "varies": self.verdict_varies}
        return {**record, "reported": True} if self.time_is_reported else record

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> RaceOutcome:
        """Return the outcome in one line of the outcome file.

        Args:
            record: the record.
        """
        task = RaceTask(*(record[name] for name in RaceTask.__slots__))
        judgement = Judgement(Verdict(_OLDER_VERDICTS.get(record["verdict"], record["verdict"])), record["residual"])
        own = {name: record[name] for name in ("contacts", "feasible", "seconds", "cold", "iterations")}
        flags = {"verdict_varies": record["varies"], "time_is_reported": record.get("reported", False)}
        return cls(task, judgement=judgement, **own, **flags)


def write_header(path: Path, conditions: dict[str, Any]) -> None:
    """Create an outcome file with the conditions of the race.

    Args:
        path: the file; its folder is created if missing.
        conditions: machine, versions and limits of the race.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"schema": SCHEMA, **conditions}) + "\n", encoding="utf-8")


def append(path: Path, outcome: RaceOutcome) -> None:
    """Append an outcome to the file.

    Args:
        path: the file.
        outcome: the outcome.
    """
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(outcome.to_dict()) + "\n")


def append_clock(path: Path, clock: dict[str, Any]) -> None:
    """Append the clock rates of a session to the file.

    Args:
        path: the file.
        clock: `conditions.clock_state` before and after the session.
    """
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps({"clock": clock}) + "\n")


def drop_partial_line(path: Path) -> None:
    """Remove an incomplete last line, so that the next outcome starts a new line.

    Args:
        path: the file.
    """
    complete, end, _ = path.read_text(encoding="utf-8").rpartition("\n")
    path.write_text(complete + end, encoding="utf-8")


def load(path: Path) -> tuple[dict[str, Any], list[RaceOutcome]]:
    """Return the conditions and outcomes of a file. An incomplete last line is skipped.

    Args:
        path: the file.

    Raises:
        InvalidInput: the file is not an outcome file.
    """
    try:
        stored = path.read_bytes()
        lines = (lzma.decompress(stored) if path.suffix == ".xz" else stored).decode().split("\n")
        conditions = dict(json.loads(lines[0]))
        records = [json.loads(line) for line in lines[1:-1]]
        clocks = [record["clock"] for record in records if "clock" in record]
        outcomes = [RaceOutcome.from_dict(record) for record in records if "clock" not in record]
    except (ValueError, KeyError, TypeError, lzma.LZMAError):
        raise InvalidInput("file", str(path), "an outcome file, written by graspforce bench --save") from None
    if conditions.get("schema") not in (SCHEMA, *_OLDER_SCHEMAS):
        raise InvalidInput("schema", conditions.get("schema"), SCHEMA)
    return ({**conditions, "clocks": clocks} if clocks else conditions), outcomes
