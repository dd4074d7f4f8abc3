"""Report of a race as a Markdown page: first the verdicts, which are reproducible, then the times, which are not."""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from graspforce.bench.conditions import clock_sentence
from graspforce.bench.judge import ACCEPTED_RESIDUAL, CORRECT_VERDICTS, TRUE_CLAIM, WRONG_LOAD_ERROR, WRONG_RESIDUAL, Verdict
from graspforce.bench.outcome import RaceOutcome
from graspforce.bench.plots import draw_figures
from graspforce.bench.statistics import (
    SHIFT,
    OutcomeGroup,
    SolverSummary,
    feasible_cases,
    group_outcomes,
    summarize_solvers,
    warm_start_gains,
)
from graspforce.bench.worker import FACETS

_WIDTH = 120  # characters per line
_REFERENCE = "clarabel"  # solver whose time is the unit of ratios between machines
_MAX_NAMED_CASES = 4  # cases that are named for each fault
_FAULTS = (Verdict.WRONG, Verdict.TIMED_OUT, Verdict.CRASHED)
_VARIES = "varies"
_FAULT_WORDS = {
    Verdict.WRONG.value: "a false claim at the requested tolerance",
    Verdict.TIMED_OUT.value: "stopped at the limit of processor time on each of three tries",
    Verdict.CRASHED.value: "raised an exception or ended its process",
    _VARIES: "several runs of a task got different verdicts; the worst counts",
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
    groups = group_outcomes(outcomes)
    captions = draw_figures(outcomes, groups, folder)
    path = folder / "report.md"
    path.write_text("\n".join(_page(conditions, outcomes, groups, captions, command)) + "\n", encoding="utf-8")
    return path


def _page(
    conditions: Mapping[str, Any],
    outcomes: Sequence[RaceOutcome],
    groups: Sequence[OutcomeGroup],
    captions: Mapping[str, str],
    command: str,
) -> Iterator[str]:
    limit = float(conditions["limit"])
    yield "# Solvers on grasp-force problems"
    yield ""
    yield from _prose(" ".join(condition_sentences(conditions, outcomes)))
    yield from _prose(f"Command: `{command}`.")
    yield from _legend()
    for group in groups:
        yield from _verdicts(group, summarize_solvers(group, limit), conditions["versions"])
    yield from _infeasible(groups)
    yield from _collections(groups)
    yield from _faults(outcomes)
    yield "## Times"
    yield ""
    yield from _prose(
        f"Time of set-up and solve, with problem data in arrays beforehand: the median of up to five runs. The mean is "
        f"geometric, shifted by {SHIFT:g} s, over the feasible cases that all solvers of the table support. A case without a "
        f"correct solution counts as {limit:g} s."
    )
    for group in groups:
        yield from _times(group, summarize_solvers(group, limit))
    for name, caption in captions.items():
        yield f"![{name.removesuffix('.png')}]({name})"
        yield ""
        yield from _prose(caption)
    yield from _warm(outcomes)
    yield from _limitations()


def condition_sentences(conditions: Mapping[str, Any], outcomes: Sequence[RaceOutcome]) -> list[str]:
    """Return sentences that state the conditions of a race: data, versions, machine, clock rates, and varying verdicts.

    Args:
        conditions: as `race.run` returns them; files of earlier versions lack some.
        outcomes: all outcomes of the race.
    """
    cases = len({outcome.task.case for outcome in outcomes})
    sentences = [
        f"{cases} cases of the problem library, {len(outcomes)} runs, at most {conditions['limit']:g} s of processor time per "
        "solve.",
    ]
    if missing := conditions.get("missing"):
        sentences.append(f"The race is not complete: {missing} runs are missing.")
    if "problems" in conditions:
        sentences.append(
            f"Problem data {conditions['problems']['version']}, SHA-256 {conditions['problems']['sha256'][:16]}…; graspforce "
            f"{conditions['versions'].get('graspforce', '')}."
        )
    for session in conditions.get("sessions", [conditions]):
        sentences += _session_sentences(session)
    varying = sum(outcome.verdict_varies for outcome in outcomes)
    share = f" ({100.0 * varying / len(outcomes):.2g} %)" if outcomes else ""
    return [*sentences, f"Verdicts varied between the runs of a task in {varying} of {len(outcomes)} tasks{share}."]


def _session_sentences(session: Mapping[str, Any]) -> Iterator[str]:
    """Return sentences that state the machine of a session, the runs on it, and its clock rates."""
    yield f"{session['machine']}, {session['cores']} cores, Python {session['python']}."
    if tasks := session.get("tasks"):
        yield f"It ran {sum(tasks.values())} runs: " + ", ".join(f"{solver} {count}" for solver, count in tasks.items()) + "."
    clocks = session.get("clocks", ())
    if (most := max((clock.get("workers", 1) for clock in clocks), default=1)) > 1:
        yield f"Up to {most} solvers ran at once."
    if clocks and all("seconds" in clock for clock in clocks):
        yield f"It took {sum(clock['seconds'] for clock in clocks) / 3600.0:.1f} h."
    yield from dict.fromkeys(map(clock_sentence, clocks))


def _prose(text: str) -> Iterator[str]:
    """Return a paragraph wrapped into lines."""
    yield from textwrap.wrap(text, _WIDTH, break_on_hyphens=False)
    yield ""


def _legend() -> Iterator[str]:
    accepted, wrong, claim = (
        ", ".join(f"{name} {value:.0e}" for name, value in residuals.items())
        for residuals in (ACCEPTED_RESIDUAL, WRONG_RESIDUAL, TRUE_CLAIM)
    )
    yield from _prose(
        "Every answer is judged by its numbers; the solver's status only states its claim. Forces are judged by themselves: by "
        "their violation of the constraints, and by their cost against the proven optimum. "
        f"Both must be at most, by settings: {accepted}. *Certified*: the multipliers prove the answer. *Correct, without "
        "multipliers*: correct forces of a solver that returns no multipliers, or of a robust case, whose multipliers are not "
        "judged. *Correct, inexact multipliers*: the multipliers "
        "do not prove the forces. *Unproven*: correctly reported infeasible, without a valid proof. *Correct* adds these four. "
        "*Claimed*: reported solved or infeasible. "
        "*Inexact*: a larger residual, from a claim that is true at the requested tolerance. *Wrong*: a false claim at this "
        f"tolerance. It is reported solved with a residual above, by settings: {wrong}; or at high settings with forces that "
        f"miss more than {WRONG_LOAD_ERROR['high']:.0e} of the load; and it also violates the solver's own rows by more than: "
        f"{claim}, relative to their numbers. Also wrong are a cost that exceeds the optimum by more than the first values, "
        "and a feasible problem that is reported infeasible, unless the solver's ray excludes forces to the accepted residual. "
        "*No answer*: the solver reports that it found none. *Timed out*: stopped at the limit. *Unsupported*: the solver does "
        f"not support such problems; counts as not correct. Pyramids have {FACETS} facets inside the exact cone, or are given "
        "by the case. *Scaled*: rows and variables in the problem's own units; *SI*: newtons and newton metres, not scaled."
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
        correct = sum(row.counts[verdict] for verdict in CORRECT_VERDICTS)
        rates = [_share(count, row.attempted) for count in (row.claimed, correct, row.counts[Verdict.WRONG])]
        name = f"{row.solver} {versions.get(row.solver, '')}".strip()
        lines.append([name, str(row.attempted), *rates, *(str(row.counts[verdict]) for verdict in shown)])
    yield from _table(["solver", "cases", "claimed", "correct", "wrong", *(f"*{v.value}*" for v in shown)], lines)


def _share(count: int, of: int) -> str:
    return f"{100.0 * count / of:.1f} %" if of else "–"


def _times(group: OutcomeGroup, table: Sequence[SolverSummary]) -> Iterator[str]:
    common, every = (len(feasible_cases(group, only_common)) for only_common in (True, False))
    yield f"**{_title(group)}**, {common} common cases of {every} feasible ones"
    yield ""
    reported = group.reported_solvers
    measured = {row.solver: row.mean for row in table if row.solver not in reported}
    best = min(measured.values(), default=math.nan)
    reference = measured.get(_REFERENCE, math.nan)
    ordered = sorted(table, key=lambda row: row.mean)
    lines = [
        [
            row.solver + " (reported)" * (row.solver in reported),
            f"{1e3 * row.mean:.3g}",
            f"{row.mean / best:.1f}",
            f"{row.mean / reference:.2f}",
            f"{1e6 * row.median:.0f}",
        ]
        for row in ordered
    ]
    if reported:
        yield from _prose("*Reported*: times of the solver's author on another machine, not measured here.")
    columns = ["solver", "shifted mean, ms", "× best", f"× {_REFERENCE}", "median of correct, µs"]
    shown = [k for k in range(len(columns)) if k != 3 or _REFERENCE in measured]
    yield from _table([columns[k] for k in shown], [[line[k] for k in shown] for line in lines])


def _infeasible(groups: Sequence[OutcomeGroup]) -> Iterator[str]:
    plain = [group for group in groups if (group.settings, group.units) == ("default", "scaled")]
    lines = []
    for group in plain:
        for solver in group.solvers:
            own = [o for o in group.outcomes if o.task.solver == solver and not o.feasible]
            if not own:
                continue
            count = Counter(o.judgement.verdict for o in own)
            held = sum(o.judgement.is_solved and o.judgement.residual is not None for o in own)
            kind = "pyramids" if group.pyramid else "exact cones"
            numbers = (
                len(own),
                sum(o.judgement.is_solved for o in own) - held,
                held,
                count[Verdict.UNPROVEN],
                count[Verdict.INEXACT] + count[Verdict.WRONG],
                count[Verdict.NO_ANSWER],
                count[Verdict.TIMED_OUT] + count[Verdict.CRASHED] + count[Verdict.UNSUPPORTED],
            )
            lines.append([f"{solver}, {kind}", *map(str, numbers)])
    if lines:
        yield "## Infeasible problems"
        yield ""
        yield from _prose(
            "Default settings, scaled. *Proved*: the solver's proof is valid. *Held*: the forces balance the load within the "
            "accepted residual, because the load is infeasible by less than that. *Reported solved*: inexact or wrong."
        )
        columns = [
            "solver",
            "cases",
            "proved",
            "held",
            "no valid proof",
            "reported solved",
            "no answer",
            "timed out, crashed, unsupported",
        ]
        yield from _table(columns, lines)


def _collections(groups: Sequence[OutcomeGroup]) -> Iterator[str]:
    for group in groups:
        if (group.settings, group.units) != ("default", "scaled"):
            continue
        names = sorted({outcome.task.case.split("/")[0] for outcome in group.outcomes})
        lines = []
        for solver in group.solvers:
            cells = [solver]
            for name in names:
                own = [o for o in group.outcomes if o.task.solver == solver and o.task.case.startswith(f"{name}/")]
                correct = sum(o.judgement.is_correct for o in own)
                cells.append(f"{correct}/{len(own)}" if own else "–")
            lines.append(cells)
        yield f"## Correct cases by collection: {_title(group)}"
        yield ""
        yield from _prose("Number of correct cases, out of the cases that the solver attempted.")
        yield from _table(["solver", *names], lines)


def _faults(outcomes: Sequence[RaceOutcome]) -> Iterator[str]:
    lines = []
    for fault, own in [
        *((v.value, [o for o in outcomes if o.judgement.verdict is v]) for v in _FAULTS),
        _varying_outcomes(outcomes),
    ]:
        grouped: dict[tuple[str, str, str, str], list[RaceOutcome]] = {}
        for outcome in own:
            task = outcome.task
            kind = ("pyramids" if task.pyramid else "exact cones") + (", warm" if task.warm else "")
            grouped.setdefault((task.solver, task.settings, task.units, kind), []).append(outcome)
        for key, members in grouped.items():
            worst_first = sorted(members, key=lambda o: (-_residual_or_zero(o), o.task.case))
            named = ", ".join(f"`{o.task.case}`{_residual_text(o)}" for o in worst_first[:_MAX_NAMED_CASES])
            more = ", …" if len(members) > _MAX_NAMED_CASES else ""
            lines.append([", ".join(key), fault, str(len(members)), named + more])
    if lines:
        yield "## Wrong verdicts, timeouts and crashes"
        yield ""
        words = "; ".join(f"*{fault}*: {meaning}" for fault, meaning in _FAULT_WORDS.items())
        yield from _prose(
            f"{words}. The number is the residual of the forces. *No residual*: reported infeasible although feasible, or "
            "reported solved without a complete solution."
        )
        yield "| solver, settings, units, cones | fault | runs | worst cases |"
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
    return " (no residual)" if outcome.judgement.verdict is Verdict.WRONG else ""


def _warm(outcomes: Sequence[RaceOutcome]) -> Iterator[str]:
    gains = warm_start_gains(outcomes)
    if gains:
        yield "**Warm starts along sequences**, default settings, scaled; steps where both solutions are correct."
        yield ""
        lines = [
            [
                f"{gain.solver}, {'pyramids' if gain.pyramid else 'exact cones'}",
                str(gain.steps),
                f"{gain.speedup:.2f}",
                f"{gain.cold_iterations:g} → {gain.warm_iterations:g}",
            ]
            for gain in gains
        ]
        yield from _table(["solver", "steps", "cold time / warm time", "iterations, cold → warm"], lines)


def _limitations() -> Iterator[str]:
    yield "## Limitations"
    yield ""
    for limitation in _LIMITATIONS:
        yield from textwrap.wrap(f"- {limitation}", _WIDTH, subsequent_indent="  ", break_on_hyphens=False)


_LIMITATIONS = (
    "The cases are force problems of 2 to 1000 contacts: small, dense, often degenerate. They do not show how a solver "
    "performs on large sparse programs, for which several of these solvers were written.",
    "Times were measured on shared machines, in calls from Python, which cost a few microseconds each. Times of different "
    "machines are not comparable; the first paragraph states which machine ran which solver. Problem data are in the solver's "
    "arrays before timing starts. Exceptions: the structured kernel, whose packing is timed, and solvers called through "
    "CasADi and solvers that generate code, whose set-up is not timed.",
    "A pyramid admits other forces than the cone that it replaces: the optimum differs, and the problem may be infeasible. "
    "Times on pyramids and on exact cones are not directly comparable.",
    "The cost of forces is compared with a proven optimum, whose relative accuracy is 1e-7 for most cases. Excesses within "
    "this accuracy are not counted.",
    "The certificate measures residuals in the units of the problem; a solver tests its own rows. First-order methods have "
    "loose default tolerances, which cause most *inexact* verdicts.",
    "*High* sets the tolerance of each solver to 1e-10, *low* to 1e-4 and *float32* to 1e-3, on its own scale. *Float32* is "
    "for solvers that compute in single precision, with programs rounded to it. Solvers without tolerances (structured, "
    "quadprog, qpoases, qrqp) behave the same in all settings. The structured kernel reads the problem itself, in its own "
    "units.",
    "Large collections are sampled evenly; `--max-cases 0` runs all cases. `--smoke` leaves out pyramids of more than 100 "
    "contacts, which some solvers take minutes to read.",
    "hpipm, ipopt, qpoases and qrqp have the version of CasADi, which contains them, and slsqp that of SciPy.",
    "A load that is infeasible by less than the accepted residual counts as held: both answers are correct to that accuracy.",
    "With some options, ProxQP does not terminate on infeasible problems. With its default options, and with tolerances of "
    "1e-9 and 1e-12, dense and sparse, it terminated on all tested programs: 267 programs in SI units with 0.6.7, 0.7.2 and "
    "0.8.0, and 78 in three systems of units with 0.8.0. With the option to solve the nearest feasible problem "
    "(*proxqp-nearest*) it often does not terminate. `python -m benchmarks.proxqp_infeasible` repeats the test with the "
    "installed version.",
    "The library stores no answer for a pyramid that replaces an exact cone: this package decided and proved its feasibility.",
    "The structured kernel and the choice of cases are this project's own. Cases and solvers can be added; each is one file.",
)
