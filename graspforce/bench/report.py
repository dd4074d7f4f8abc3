"""The report as a Markdown page: verdicts first, which a second run repeats, then times, which it does not."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from graspforce.bench.judge import ACCEPTED_RESIDUAL, WRONG_RESIDUAL, Verdict
from graspforce.bench.outcome import RaceOutcome
from graspforce.bench.plots import draw_figures
from graspforce.bench.statistics import (
    SHIFT,
    OutcomeGroup,
    SolverSummary,
    group_outcomes,
    summarize_solvers,
    warm_start_gains,
)
from graspforce.bench.worker import FACETS

_WIDTH = 120  # of a line
_MAX_NAMED_CASES = 4  # cases of each fault that are named
_FAULTS = (Verdict.WRONG, Verdict.TIMED_OUT, Verdict.CRASHED)
_VARIES = "varies"
_FAULT_WORDS = {
    Verdict.WRONG.value: "called solved, or infeasible, and it is not so",
    Verdict.TIMED_OUT.value: "did not end within the limit of processor time on any of three tries, and was ended",
    Verdict.CRASHED.value: "raised, or took its process with it",
    _VARIES: "several runs of the same got different verdicts, of which the worst counts",
}


def write(folder: Path, conditions: Mapping[str, Any], outcomes: Sequence[RaceOutcome], command: str) -> Path:
    """Write ``report.md`` and its figures into a folder, and return the page's path.

    Args:
        folder: the folder; created if missing.
        conditions: machine, versions and limits of the race.
        outcomes: all outcomes.
        command: the command that reproduces the race.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found = group_outcomes(outcomes)
    pictures = draw_figures(outcomes, found, folder)
    path = folder / "report.md"
    path.write_text("\n".join(_page(conditions, outcomes, found, pictures, command)) + "\n", encoding="utf-8")
    return path


def _page(
    conditions: Mapping[str, Any],
    outcomes: Sequence[RaceOutcome],
    found: Sequence[OutcomeGroup],
    pictures: Mapping[str, str],
    command: str,
) -> Iterator[str]:
    limit = float(conditions["limit"])
    cases = len({outcome.task.case for outcome in outcomes})
    yield "# Solvers on grasp-force problems"
    yield ""
    yield from _prose(
        f"{cases} cases of the problem library, {len(outcomes)} runs, at most {limit:g} s of processor time for one solve. "
        f"{conditions['machine']}, {conditions['cores']} cores, Python {conditions['python']}. Made by `{command}`."
    )
    yield from _legend()
    for group in found:
        yield from _verdicts(group, summarize_solvers(group, limit), conditions["versions"])
    yield from _infeasible(found)
    yield from _collections(found)
    yield from _faults(outcomes)
    yield "## Times"
    yield ""
    yield from _prose(
        f"Set-up and solve on arrays that are built already, the median of up to five runs. The mean is geometric, shifted by "
        f"{SHIFT:g} s, over the feasible cases that every solver of the table takes; a case without a certified answer counts "
        f"as {limit:g} s."
    )
    for group in found:
        yield from _times(group, summarize_solvers(group, limit))
    for name, what in pictures.items():
        yield f"![{name.removesuffix('.png')}]({name})"
        yield ""
        yield from _prose(what)
    yield from _warm(outcomes)
    yield from _limits()


def _prose(text: str) -> Iterator[str]:
    """Return a paragraph wrapped into lines."""
    yield from textwrap.wrap(text, _WIDTH)
    yield ""


def _legend() -> Iterator[str]:
    accepted = ", ".join(f"{name} {value:.0e}" for name, value in ACCEPTED_RESIDUAL.items())
    yield from _prose(
        "Every answer is judged by its certificate; the solver's own status does not count. "
        "*Claimed*: reported solved or infeasible. *Correct*: certified, or correctly reported infeasible (*unproven* without "
        f"a valid proof). The residual of the certificate must be at most, by settings: {accepted}. "
        f"*Inexact*: reported solved, with a larger residual within {WRONG_RESIDUAL:g}. "
        f"*Wrong*: reported solved with a residual above {WRONG_RESIDUAL:g}, or reported infeasible although feasible. "
        "*No answer*: the solver reports that it found none. *Timed out*: stopped at the limit. *Unsupported*: the solver does "
        f"not take such problems, which counts as not correct. Pyramids have {FACETS} facets inside the exact cone, or are the "
        "case's own. *Scaled*: rows and variables in the problem's own units; *SI*: newtons and newton metres, not scaled."
    )


def _title(group: OutcomeGroup) -> str:
    kind = "Pyramids" if group.pyramid else "Exact cones"
    return f"{kind}, {group.settings} settings, {'SI units' if group.units == 'si' else 'scaled'}"


def _table(columns: Sequence[str], lines: Iterable[Sequence[str]]) -> Iterator[str]:
    yield "| " + " | ".join(columns) + " |"
    yield "|---|" + "---:|" * (len(columns) - 1)
    for cells in lines:
        yield "| " + " | ".join(cells) + " |"
    yield ""


def _verdicts(group: OutcomeGroup, table: Sequence[SolverSummary], versions: Mapping[str, str]) -> Iterator[str]:
    yield f"## {_title(group)}"
    yield ""
    shown = [verdict for verdict in Verdict if any(row.counts[verdict] for row in table)]
    lines = []
    for row in table:
        correct = row.counts[Verdict.CERTIFIED] + row.counts[Verdict.UNPROVEN]
        rates = [_share(count, row.attempted) for count in (row.claimed, correct, row.counts[Verdict.WRONG])]
        name = f"{row.solver} {versions.get(row.solver, '')}".strip()
        lines.append([name, str(row.attempted), *rates, *(str(row.counts[verdict]) for verdict in shown)])
    yield from _table(["solver", "cases", "claimed", "correct", "wrong", *(f"*{v.value}*" for v in shown)], lines)


def _share(count: int, of: int) -> str:
    return f"{100.0 * count / of:.1f} %" if of else "–"


def _times(group: OutcomeGroup, table: Sequence[SolverSummary]) -> Iterator[str]:
    yield f"**{_title(group)}**"
    yield ""
    best = min(row.mean for row in table)
    ordered = sorted(table, key=lambda row: row.mean)
    lines = [[row.solver, f"{1e3 * row.mean:.3g}", f"{row.mean / best:.1f}", f"{1e6 * row.median:.0f}"] for row in ordered]
    yield from _table(["solver", "shifted mean, ms", "× best", "median of certified, µs"], lines)


def _infeasible(found: Sequence[OutcomeGroup]) -> Iterator[str]:
    plain = [group for group in found if (group.settings, group.units) == ("default", "scaled")]
    lines = []
    for group in plain:
        for solver in group.solvers:
            own = [o for o in group.outcomes if o.task.solver == solver and not o.feasible]
            if not own:
                continue
            counts = [sum(o.judgement.verdict is v for o in own) for v in Verdict]
            proved, unproven, inexact, wrong, no_answer, timed_out, crashed, unsupported = counts
            solved = sum(o.judgement.verdict is Verdict.CERTIFIED and o.judgement.residual is not None for o in own)
            kind = "pyramids" if group.pyramid else "exact cones"
            numbers = (
                len(own),
                proved - solved,
                solved,
                unproven,
                inexact + wrong,
                no_answer,
                timed_out + crashed + unsupported,
            )
            lines.append([f"{solver}, {kind}", *map(str, numbers)])
    if lines:
        yield "## Infeasible problems"
        yield ""
        yield from _prose(
            "Default settings, scaled. *Proved*: the solver's proof is valid. *Held*: forces hold the load within the accepted "
            "residual, because the load is infeasible by less than that. *Called solved*: wrongly."
        )
        columns = [
            "solver",
            "cases",
            "proved",
            "held",
            "no valid proof",
            "called solved",
            "no answer",
            "timed out, crashed, unsupported",
        ]
        yield from _table(columns, lines)


def _collections(found: Sequence[OutcomeGroup]) -> Iterator[str]:
    for group in found:
        if (group.settings, group.units) != ("default", "scaled"):
            continue
        names = sorted({outcome.task.case.split("/")[0] for outcome in group.outcomes})
        lines = []
        for solver in group.solvers:
            cells = [solver]
            for name in names:
                own = [o for o in group.outcomes if o.task.solver == solver and o.task.case.startswith(f"{name}/")]
                right = sum(o.judgement.verdict in (Verdict.CERTIFIED, Verdict.UNPROVEN) for o in own)
                cells.append(f"{right}/{len(own)}" if own else "–")
            lines.append(cells)
        yield f"## Correct, by collection: {_title(group)}"
        yield ""
        yield from _prose("Cases that are correct, of those that the solver was asked.")
        yield from _table(["solver", *names], lines)


def _faults(outcomes: Sequence[RaceOutcome]) -> Iterator[str]:
    lines = []
    for what, own in [
        *((v.value, [o for o in outcomes if o.judgement.verdict is v]) for v in _FAULTS),
        _varying_outcomes(outcomes),
    ]:
        grouped: dict[tuple[str, str, str, str], list[RaceOutcome]] = {}
        for outcome in own:
            task = outcome.task
            kind = ("pyramids" if task.pyramid else "exact cones") + (", warm" if task.warm else "")
            grouped.setdefault((task.solver, task.settings, task.units, kind), []).append(outcome)
        for key, alike in grouped.items():
            first = sorted(alike, key=lambda o: (-_residual_or_zero(o), o.task.case))
            named = ", ".join(f"`{o.task.case}`{_residual_text(o)}" for o in first[:_MAX_NAMED_CASES])
            more = ", …" if len(alike) > _MAX_NAMED_CASES else ""
            lines.append([", ".join(key), what, str(len(alike)), named + more])
    if lines:
        yield "## Lies, hangs and crashes, by name"
        yield ""
        words = "; ".join(f"*{what}*: {meaning}" for what, meaning in _FAULT_WORDS.items())
        yield from _prose(
            f"{words}. The figure is the certificate's residual; *no answer* stands for a false claim that there is none."
        )
        yield "| solver, settings, units, cones | what | runs | the worst |"
        yield "|---|---|---:|---|"
        yield from ("| " + " | ".join(cells) + " |" for cells in lines)
        yield ""


def _varying_outcomes(outcomes: Sequence[RaceOutcome]) -> tuple[str, list[RaceOutcome]]:
    return _VARIES, [outcome for outcome in outcomes if outcome.verdict_varies]


def _residual_or_zero(outcome: RaceOutcome) -> float:
    residual = outcome.judgement.residual
    return 0.0 if residual is None else residual


def _residual_text(outcome: RaceOutcome) -> str:
    if outcome.judgement.residual is not None:
        return f" ({outcome.judgement.residual:.0e})"
    return " (no answer)" if outcome.judgement.verdict is Verdict.WRONG else ""


def _warm(outcomes: Sequence[RaceOutcome]) -> Iterator[str]:
    found = warm_start_gains(outcomes)
    if found:
        yield "**Warm starts along sequences**, default settings, scaled; steps where both answers are certified."
        yield ""
        lines = [
            [
                f"{gain.solver}, {'pyramids' if gain.pyramid else 'exact cones'}",
                str(gain.steps),
                f"{gain.speedup:.2f}",
                f"{gain.cold_iterations:g} → {gain.warm_iterations:g}",
            ]
            for gain in found
        ]
        yield from _table(["solver", "steps", "cold over warm", "iterations"], lines)


def _limits() -> Iterator[str]:
    yield "## What this does not show"
    yield ""
    for limit in _LIMITS:
        yield from textwrap.wrap(f"- {limit}", _WIDTH, subsequent_indent="  ")


_LIMITS = (
    "The cases are force problems of 2 to 1000 contacts: small, dense, often degenerate. They do not show how a "
    "solver performs on large sparse programs, for which several of these were written.",
    "Times hold for one shared machine, one process at a time, and for calls from Python: a few microseconds of each "
    "belong to the binding. Problem data are in the solver's arrays before the clock starts. Exceptions: the "
    "structured kernel, whose packing is timed, and solvers called through CasADi, whose set-up is not.",
    "A pyramid is another problem than the cone that it replaces: fewer forces, another optimum, sometimes "
    "infeasible. Compare times between the two only with that in mind.",
    "The certificate needs multipliers: good forces with poor multipliers prove nothing.",
    "The certificate measures in the problem's own units; a solver tests its own rows. With default settings, first- "
    "order methods stop where their authors chose, and most *inexact* verdicts come from that choice.",
    "*High* sets the tolerance of each solver to 1e-10 and *low* to 1e-4, on its own scale. Solvers without "
    "tolerances (structured, quadprog, qpoases, qrqp) do the same in all settings. The structured kernel takes the "
    "problem itself, in its own units.",
    "Cases are left out where their dense form would take minutes to build: pyramids beyond 100 contacts and, except "
    "for the structured kernel, cones beyond 300. Of large collections only some cases are run, evenly spaced, unless "
    "`--max-cases 0` runs all.",
    "Close to the edge of feasibility, a load that is infeasible by less than the accepted residual counts as held: "
    "both answers are correct to that accuracy.",
    "ProxQP can run without end on infeasible problems. With its own settings, and with tolerances of 1e-9 and 1e-12, "
    "dense and sparse, it ended on every one that was tried: 267 programs in SI units with 0.6.7, 0.7.2 and 0.8.0, "
    "and 78 in three systems of units with 0.8.0. With the option to solve the nearest feasible problem (*proxqp- "
    "nearest*) it often does not end. `python -m benchmarks.proxqp_infeasible` repeats the test with the installed "
    "version.",
    "A pyramid in place of an exact cone has no stored answer: its feasibility was found and proven by this package.",
    "The structured kernel and the choice of cases are this project's own. Anyone can add cases and solvers: each is one file.",
)
