"""A static page of a race: one file that needs no server. Tables, profiles, cases and solvers are drawn by its script.

The data are compressed, so that a race of all solvers on all cases makes a page of less than 2 MB.

`history.json` beside the page keeps the results of earlier versions; a later page with the same folder shows them.
"""

from __future__ import annotations

import base64
import gzip
import json
import math
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from graspforce import problems
from graspforce.bench.export.tags import case_tags
from graspforce.bench.judge import CORRECT_VERDICTS, WRONG_LOAD_ERROR, WRONG_RESIDUAL, Verdict
from graspforce.bench.outcome import RaceOutcome
from graspforce.bench.report import condition_sentences
from graspforce.bench.statistics import group_outcomes, summarize_solvers
from graspforce.core.whole_file import write_text
from graspforce.hand.actuation import Actuation
from graspforce.problems.case import Case, ExpectedOptimum

MAX_DRAWN_CONTACTS = 40  # contacts in the picture of a case
_DIGITS, _RESIDUAL_DIGITS = 3, 2  # significant digits of positions, normals and times, and of residuals
_SCRIPTS = ("statistics.js", "charts.js", "reproduce.js", "views.js")
# An entry of a history replaces an earlier one with equal fields. Entries of earlier versions lack some of them.
_HISTORY_KEYS = ("solver", "version", "graspforce", "data", "group", "cases", "limit")


def write_site(
    folder: Path,
    conditions: Mapping[str, Any],
    outcomes: Sequence[RaceOutcome],
    command: str,
    problem_folder: Path | None = None,
    answer_files: Sequence[Path] = (),
) -> Path:
    """Write ``index.html`` and ``history.json`` into a folder, and return the page's path.

    Args:
        folder: the folder; created if missing.
        conditions: machine, versions and limits of the race.
        outcomes: all outcomes.
        command: the command that reproduces the race.
        problem_folder: folder of collections that replaced the library; None for the library.
        answer_files: files with the answers of solvers that did not run here; each file has the name of its solver.
    """
    folder.mkdir(parents=True, exist_ok=True)
    history = save_history(folder / "history.json", conditions, outcomes)
    sources = {
        "folder": "" if problem_folder is None else str(problem_folder),
        "answers": {path.stem: str(path) for path in answer_files},
    }
    data = {**page_data(conditions, outcomes), **sources, "command": command, "history": history}
    parts = {
        "css": _part("page.css"),
        "script": "\n".join(_part(name) for name in _SCRIPTS),
        "data": _compressed(data),
    }
    text = _part("page.html")
    for name, value in parts.items():
        text = text.replace("{" + name + "}", value)
    page = folder / "index.html"
    write_text(page, text)
    return page


def page_data(conditions: Mapping[str, Any], outcomes: Sequence[RaceOutcome]) -> dict[str, Any]:
    """Return the data of the page: solvers, cases, and the numbers of the runs, one list for each field.

    Args:
        conditions: machine, versions and limits of the race.
        outcomes: all outcomes.
    """
    solvers = tuple(dict.fromkeys(outcome.task.solver for outcome in outcomes))
    names = tuple(sorted({outcome.task.case for outcome in outcomes}))
    feasible: dict[tuple[str, bool], bool] = {(one.task.case, one.task.pyramid): one.feasible for one in outcomes}
    solver_indices, case_indices = ({key: i for i, key in enumerate(keys)} for keys in (solvers, names))
    verdicts = tuple(Verdict)
    rows = [_run_row(one, solver_indices[one.task.solver], case_indices[one.task.case], verdicts) for one in outcomes]
    return {
        "limit": conditions["limit"],
        "wrong_residual": WRONG_RESIDUAL,
        "wrong_load": WRONG_LOAD_ERROR,
        "facts": " ".join(condition_sentences(conditions, outcomes)),
        "verdicts": [verdict.value for verdict in verdicts],
        "solvers": [{"name": name, "version": conditions["versions"].get(name, "")} for name in solvers],
        "cases": [_case_record(name, feasible) for name in names],
        "runs": [list(column) for column in zip(*rows, strict=True)] or [[]],
    }


def _run_row(outcome: RaceOutcome, solver: int, case: int, verdicts: Sequence[Verdict]) -> list[Any]:
    """Return the numbers of a run, in the order of FIELDS in statistics.js."""
    task, judgement = outcome.task, outcome.judgement
    flags = [int(task.pyramid), int(task.warm), int(outcome.cold is not None), int(outcome.time_is_reported)]
    numbers = [_rounded(judgement.residual, _RESIDUAL_DIGITS), _rounded(outcome.seconds), outcome.iterations]
    return [solver, task.settings, task.units, *flags, case, verdicts.index(judgement.verdict), *numbers]


def _case_record(name: str, feasible: Mapping[tuple[str, bool], bool]) -> dict[str, Any]:
    """Return the facts of a case that the page shows; ``feasible`` by exact cones and pyramids."""
    case: Case = problems.load(name)
    problem, known = case.problem, case.expected
    is_feasible = isinstance(known, ExpectedOptimum)
    drawn = problem.contacts.contacts[:MAX_DRAWN_CONTACTS]
    return {
        "name": name,
        "source": case.source,
        "contacts": len(problem.contacts),
        "objective": problem.objective.type,
        "load": [_rounded(float(value)) for value in problem.w],
        "limits": None if problem.actuation is None else _count_limits(problem.actuation),
        "feasible": [feasible.get((name, pyramid), is_feasible) for pyramid in (False, True)],
        "optimum": _rounded(known.objective) if isinstance(known, ExpectedOptimum) else None,
        "tags": list(case_tags(case)),
        "positions": [[_rounded(float(value)) for value in one.position] for one in drawn],
        "normals": [[_rounded(float(value)) for value in one.normal] for one in drawn],
        "frictions": [_rounded(float(value)) for value in problem.contacts.mu[: len(drawn)]],
    }


def _count_limits(actuation: Actuation) -> int:
    """Return the number of finite torque limits, lower and upper ones."""
    return int(np.isfinite([actuation.lower, actuation.upper]).sum())


def save_history(path: Path, conditions: Mapping[str, Any], outcomes: Sequence[RaceOutcome]) -> list[dict[str, Any]]:
    """Add the results of a race to a history, save it, and return it.

    An entry replaces the earlier one with equal versions, group, number of cases and limit. New entries are the last ones.

    Args:
        path: ``history.json``; created if missing.
        conditions: machine, versions and limits of the race.
        outcomes: all outcomes.
    """
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    versions = conditions["versions"]
    data = conditions.get("problems", {}).get("version", "")
    added = []
    for group in group_outcomes(outcomes):
        title = ", ".join(["pyramids" if group.pyramid else "exact cones", group.settings, group.units])
        reported = group.reported_solvers
        for row in summarize_solvers(group, float(conditions["limit"])):
            added.append(
                {
                    "solver": row.solver,
                    "version": versions.get(row.solver, ""),
                    "graspforce": versions.get("graspforce", ""),
                    "data": data,
                    "group": title,
                    "cases": row.attempted,
                    "limit": float(conditions["limit"]),
                    "correct": sum(row.counts[verdict] for verdict in CORRECT_VERDICTS),
                    "wrong": row.counts[Verdict.WRONG],
                    "mean": None if math.isnan(row.mean) else _rounded(row.mean),
                    "reported": row.solver in reported,
                }
            )
    replaced = {_history_key(entry) for entry in added}
    history = [*(entry for entry in known if _history_key(entry) not in replaced), *added]
    write_text(path, json.dumps(history, indent=1) + "\n")
    return history


def _history_key(entry: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(entry.get(key) for key in _HISTORY_KEYS)


def _rounded(value: float | None, digits: int = _DIGITS) -> float | None:
    return None if value is None else float(f"{value:.{digits}g}")


def _compressed(data: Mapping[str, Any]) -> str:
    """Return data as JSON, compressed and in letters that HTML allows."""
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"))
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def _part(name: str) -> str:
    return (resources.files("graspforce.bench") / "page" / name).read_text(encoding="utf-8").strip()
