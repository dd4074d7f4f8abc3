"""The table of results in a README, from the history that `site.write_site` saves beside its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from graspforce.core.errors import InvalidInput

BEGIN, END = "<!-- results of the benchmark: begin -->", "<!-- results of the benchmark: end -->"
GROUPS = {"exact cones": "exact cones, default, scaled", "pyramids": "pyramids, default, scaled"}
_REFERENCE = "clarabel"  # solver whose mean time is 1


def readme_table(history: Sequence[Mapping[str, Any]]) -> str:
    """Return the table: correct and wrong answers of each solver, and its mean time over that of Clarabel.

    Args:
        history: entries of ``history.json``; the last one of a solver and group counts.

    Raises:
        InvalidInput: Clarabel is missing, with which the others are compared.
    """
    latest = {(entry["group"], entry["solver"]): entry for entry in history}
    solvers = tuple(dict.fromkeys(entry["solver"] for entry in history))
    for group in GROUPS.values():
        if (group, _REFERENCE) not in latest:
            raise InvalidInput("history", group, f"results with the solver {_REFERENCE}")
    heads = [f"{name}: {what}" for name in GROUPS for what in ("correct", "wrong", "time")]
    lines = ["| solver | " + " | ".join(heads) + " |", "|---|" + "---:|" * len(heads)]
    for solver in solvers:
        cells = [cell for group in GROUPS.values() for cell in _cells(latest.get((group, solver)), latest[group, _REFERENCE])]
        lines.append("| " + " | ".join([solver, *cells]) + " |")
    return "\n".join(lines)


def _cells(entry: Mapping[str, Any] | None, reference: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return the share of correct answers, the number of wrong ones, and the ratio of times, marked if they are reported."""
    if entry is None:
        return "–", "–", "–"
    has_times = entry["mean"] is not None and reference["mean"] is not None
    ratio = f"{entry['mean'] / reference['mean']:.1f} ×" if has_times else "–"
    if has_times and (entry.get("reported", False) or reference.get("reported", False)):
        ratio += " (reported)"
    return f"{entry['correct']} of {entry['cases']}", str(entry["wrong"]), ratio


def replace_table(text: str, table: str) -> str:
    """Return a text with the table between its marks replaced.

    Args:
        text: the README.
        table: the table, from `readme_table`.

    Raises:
        InvalidInput: the text lacks the marks.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise InvalidInput("readme", "a text without marks", f"a text with the lines {BEGIN} and {END}")
    return f"{before}{begin}\n{table}\n{end}{after}"
