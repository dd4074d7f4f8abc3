"""One race: a solver, a case, and how it went; and the file that keeps them, one JSON record a line."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from graspforce.bench.judge import Judgement, Verdict
from graspforce.core.errors import InvalidInput

SCHEMA = "graspforce/bench/3"
_OLDER_SCHEMA = "graspforce/bench/2"  # differs in four words
_OLDER_VERDICTS = {"lied": "wrong", "gave up": "no answer", "stopped": "timed out", "refused": "unsupported"}


@dataclass(frozen=True, slots=True)
class RaceTask:
    """What is to be run.

    Args:
        solver: its name, or the module that holds it.
        settings: "default", "high" or "low".
        units: "scaled" (the program in units of its own) or "si".
        pyramid: whether an exact case is given as an inner pyramid of `FACETS` facets.
        warm: whether it starts from the solver's cold answer to the case before it in its sequence.
        case: its name in the library.
    """

    solver: str
    settings: str
    units: str
    pyramid: bool
    warm: bool
    case: str


@dataclass(frozen=True, slots=True)
class RaceOutcome:
    """How it went.

    Args:
        task: what was run.
        contacts: of the case.
        feasible: whether the case has an answer.
        judgement: what the answer is worth; of several runs' answers the worst one.
        seconds: set-up and solve, cold the median of some runs, warm of one; None unless certified.
        cold: of a warm run, what a cold one just before took, s; None where there was nothing to start from.
        iterations: the solver's own count, in its first run.
        varies: whether it got different verdicts in several runs of the same.
    """

    task: RaceTask
    contacts: int
    feasible: bool
    judgement: Judgement
    seconds: float | None
    cold: float | None
    iterations: int
    verdict_varies: bool = False

    def to_dict(self) -> dict[str, Any]:
        """One line of the file."""
        record = {**asdict(self.task), "contacts": self.contacts, "feasible": self.feasible}
        record |= {"verdict": self.judgement.verdict.value, "residual": self.judgement.residual}
        record |= {"seconds": self.seconds, "cold": self.cold, "iterations": self.iterations, "varies": self.verdict_varies}
        return record

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> RaceOutcome:
        """From one line of the file."""
        task = RaceTask(*(record[name] for name in RaceTask.__slots__))
        judgement = Judgement(Verdict(_OLDER_VERDICTS.get(record["verdict"], record["verdict"])), record["residual"])
        own = (record[name] for name in ("seconds", "cold", "iterations", "varies"))
        return cls(task, record["contacts"], record["feasible"], judgement, *own)


def write_header(path: Path, conditions: dict[str, Any]) -> None:
    """Start a file with the conditions of the race."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"schema": SCHEMA, **conditions}) + "\n", encoding="utf-8")


def append(path: Path, outcome: RaceOutcome) -> None:
    """Add one line."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(outcome.to_dict()) + "\n")


def drop_partial_line(path: Path) -> None:
    """Cut off a last line that was not finished, so that the next one begins on its own."""
    whole, end, _ = path.read_text(encoding="utf-8").rpartition("\n")
    path.write_text(whole + end, encoding="utf-8")


def load(path: Path) -> tuple[dict[str, Any], list[RaceOutcome]]:
    """Return the conditions and outcomes of a file; an incomplete last line is skipped.

    Raises:
        InvalidInput: not such a file.
    """
    lines = path.read_text(encoding="utf-8").split("\n")
    try:
        conditions = dict(json.loads(lines[0]))
        outcomes = [RaceOutcome.from_dict(json.loads(line)) for line in lines[1:-1]]
    except (ValueError, KeyError, TypeError):
        raise InvalidInput("file", str(path), "a file that graspforce bench --save wrote") from None
    if conditions.get("schema") not in (SCHEMA, _OLDER_SCHEMA):
        raise InvalidInput("schema", conditions.get("schema"), SCHEMA)
    return conditions, outcomes
