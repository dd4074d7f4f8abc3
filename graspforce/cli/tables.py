"""Tables of the command line: solutions, cases, benchmark results and hands, for terminals of 80 columns or more."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from graspforce.bench.judge import CORRECT_VERDICTS, Verdict
from graspforce.bench.library_check import CollectionSummary
from graspforce.bench.outcome import RaceOutcome
from graspforce.bench.statistics import compare_races, group_outcomes, summarize_solvers
from graspforce.contact.contact import ContactModel
from graspforce.core.arrays import Array
from graspforce.force.certificate import Certificate
from graspforce.force.infeasibility import Infeasibility
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution
from graspforce.force.status import Status
from graspforce.problems import Case, ExpectedOptimum

NO_VALUE = "–"
_DIGITS = 6  # significant digits of the largest number of a column
_ROUNDING = 1e-9  # relative: smaller components are rounding errors
_AT_LIMIT = 0.9995  # a fraction that prints as 100 %

_STYLE = {
    Status.OPTIMAL: "bold green",
    Status.INACCURATE: "bold yellow",
    Status.INFEASIBLE: "bold red",
    Status.FAILED: "bold red",
}


def solution_report(problem: ForceProblem, solution: Solution) -> RenderableType:
    """Return the report of a solution: problem, forces and torques or infeasibility, certificate, solver.

    Args:
        problem: the problem.
        solution: its solution.
    """
    parts: list[RenderableType] = [_heading(problem), ""]
    status = solution.status
    parts.append(Text.assemble((status.value.capitalize(), _STYLE[status]), f": {status.sentence}"))
    if solution.found:
        parts += [_objective(problem, solution), "", contact_table(problem, solution)]
        if problem.actuation is not None:
            parts += ["", torque_table(problem, solution)]
    if solution.robust is not None:
        parts += ["", Text(solution.robust.statement)]
    if solution.infeasibility is not None:
        parts += ["", *_infeasibility_lines(problem, solution.infeasibility)]
    if solution.certificate is not None:
        parts += ["", Text(_certificate_text(solution.status, solution.certificate))]
    solver = f"Solver: {solution.backend}, {solution.iterations} iterations, {_time(solution.seconds)}."
    return Group(*parts, Text(solver, style="dim"))


def contact_table(problem: ForceProblem, solution: Solution) -> Table:
    """Return the table of contact forces in their frames, with limits and slip margins.

    Args:
        problem: the problem.
        solution: a solution with forces.
    """
    contacts = problem.contacts
    padded = contacts.pad(solution.f)
    soft = ContactModel.SOFT in contacts.models
    bounded = (np.isfinite(contacts.max_normal) | (contacts.min_normal > 0)).any()
    largest = float(np.abs(padded[:, :3]).max())  # N
    columns: list[tuple[str, Iterable[str]]] = [("contact", map(str, range(len(contacts))))]
    for title, column in (("f_t1 (N)", 0), ("f_t2 (N)", 1), ("f_n (N)", 2), *((("m_n (N·m)", 3),) if soft else ())):
        carried = [column in model.columns for model in contacts.models]
        columns.append((title, _numbers(padded[:, column], carried, None if column == 3 else largest)))
    if bounded:
        columns.append(("f_n limits (N)", map(range_text, contacts.min_normal, contacts.max_normal)))
    rough = [mu > 0 for mu in contacts.mu]
    columns.append(("slip margin (N)", _numbers(solution.slip_margin, rough, largest)))
    shares = zip(solution.friction_used, rough, strict=True)
    columns.append(("friction used", (_percent(used) if has else NO_VALUE for used, has in shares)))
    return make_table(columns)


def torque_table(problem: ForceProblem, solution: Solution) -> Table:
    """Return the table of motor torques and limits. A limit of zero counts as fully used.

    Args:
        problem: a problem with an actuation.
        solution: a solution with forces.
    """
    actuation = problem.actuation
    assert actuation is not None  # the caller checked
    lower, upper, tau = actuation.lower, actuation.upper, solution.torques
    nearest = np.where(tau >= 0, upper, lower)
    used = [
        NO_VALUE if not math.isfinite(limit) else _percent(t / limit if limit else 1.0)
        for t, limit in zip(tau, nearest, strict=True)
    ]
    columns = [
        ("joint", map(str, range(len(tau)))),
        ("torque (N·m)", _numbers(tau)),
        ("limits (N·m)", map(range_text, lower, upper)),
        ("limit used", used),
    ]
    return make_table(columns)


def case_list(cases: Sequence[Case]) -> RenderableType:
    """Return the list of cases: name, contacts, objective, cone and answer, with the source on a second line.

    Args:
        cases: the cases.
    """
    rows = [("case", "contacts", "objective", "cone", "expected")]
    for case in cases:
        problem, known = case.problem, case.expected
        cone = "exact" if problem.cone.type == "exact" else f"{problem.cone.side} {problem.cone.facets}"
        expected = f"{known.objective:.6g}" if isinstance(known, ExpectedOptimum) else known.status.value
        rows.append((case.name, str(len(problem.contacts)), problem.objective.type, cone, expected))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [_line("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip()) for row in rows]
    lines[0].stylize("bold")
    parts = [lines[0]]
    for line, case in zip(lines[1:], cases, strict=True):
        parts += [line, _line(f"  {case.source}", "dim")]
    return Group(*parts)


def _line(text: str, style: str = "") -> Text:
    """Return a line that is cut at the width of the terminal."""
    return Text(text, style=style, no_wrap=True, overflow="ellipsis")


def collection_list(collections: Sequence[tuple[str, int, str]]) -> RenderableType:
    """Return the table of collections.

    Args:
        collections: name, number of cases and description of each.
    """
    names, counts, words = zip(*collections, strict=True)
    table = make_table([("collection", names), ("contents", words), ("cases", map(str, counts))], left=2)
    return Group(
        table, "", Text(f"{sum(counts)} cases. `graspforce problems list COLLECTION` lists them; `show CASE` prints one.")
    )


def collection_summary_table(summaries: Sequence[CollectionSummary]) -> RenderableType:
    """Return the results of verifying the library by collection, and the cases that failed.

    Args:
        summaries: one for each collection.
    """
    columns = [
        ("collection", [summary.collection for summary in summaries]),
        ("optimal", [str(summary.optimal) for summary in summaries]),
        ("infeasible", [str(summary.infeasible) for summary in summaries]),
        ("residual", [f"{summary.residual:.0e}" for summary in summaries]),
        ("difference/tolerance", [f"{summary.difference:.2f}" for summary in summaries]),
        ("failed", [str(len(summary.failed)) for summary in summaries]),
    ]
    failed = [Text(f"{name}: verification failed", style="bold red") for summary in summaries for name in summary.failed]
    cases = sum(summary.optimal + summary.infeasible for summary in summaries)
    verdict = (
        f"{cases - len(failed)} of {cases} cases verified: optima solved again and certified, infeasibility proofs checked."
    )
    return Group(make_table(columns), *failed, Text(verdict, style="bold red" if failed else "bold green"))


def race_tables(outcomes: Sequence[RaceOutcome], limit: float) -> Iterator[RenderableType]:
    """Yield the tables of a race: success counts and times, one for each kind of cone, settings and units.

    Args:
        outcomes: outcomes of the race.
        limit: processor time after which a solver was stopped, s.
    """
    for group in group_outcomes(outcomes):
        table = sorted(summarize_solvers(group, limit), key=lambda row: row.mean)
        reported = group.reported_solvers
        right = [sum(row.counts[verdict] for verdict in CORRECT_VERDICTS) for row in table]
        columns = [
            ("solver", [row.solver for row in table]),
            ("cases", [str(row.attempted) for row in table]),
            ("claimed", [str(row.claimed) for row in table]),
            ("correct", [str(count) for count in right]),
            ("inexact", [str(row.counts[Verdict.INEXACT]) for row in table]),
            ("wrong", [str(row.counts[Verdict.WRONG]) for row in table]),
            ("timed out", [str(row.counts[Verdict.TIMED_OUT] + row.counts[Verdict.CRASHED]) for row in table]),
            ("mean", [_time(row.mean) + " (reported)" * (row.solver in reported) for row in table]),
        ]
        kind = "pyramids" if group.pyramid else "exact cones"
        yield Text(f"{kind}, {group.settings} settings, {group.units} units", style="bold")
        yield make_table(columns)
        yield ""


def difference_table(before: Sequence[RaceOutcome], now: Sequence[RaceOutcome]) -> RenderableType:
    """Return the differences from an earlier race: changed verdicts, and ratios of times by solver.

    Args:
        before: outcomes of the earlier race.
        now: outcomes of this race.
    """
    changed, ratios = compare_races(before, now)
    lines = [
        f"{new.task.solver}, {new.task.settings}, {new.task.units}, {new.task.case}{', warm' if new.task.warm else ''}: "
        f"{old.judgement.verdict.value} before, {new.judgement.verdict.value} now"
        for old, new in changed
    ]
    times = [("solver", list(ratios)), ("time now / before", [f"{ratio:.2f}" for ratio in ratios.values()])]
    return Group(
        make_table(times), "", *map(Text, lines), Text(f"{count_text(len(changed), 'verdict')} changed.", style="bold")
    )


def _heading(problem: ForceProblem) -> RenderableType:
    if not _has_friction(problem):
        cones = "without friction"
    else:
        cones = "with exact friction cones" if problem.cone.type == "exact" else f"with an {_cone(problem)}"
    contacts = count_text(len(problem.contacts), "contact")
    return Text.assemble(
        (problem.name or "Force problem", "bold"), f": {contacts} {cones}\nWrench to supply: {_wrench(problem.w)}"
    )


def _has_friction(problem: ForceProblem) -> bool:
    return bool(((problem.contacts.mu > 0) | (problem.contacts.gamma > 0)).any())


def _cone(problem: ForceProblem) -> str:
    return f"{problem.cone.side} pyramid of {problem.cone.facets} facets"


def _objective(problem: ForceProblem, solution: Solution) -> Text:
    """Return the value of the objective with its law and unit."""
    kind, value = problem.objective.type, f"{solution.objective:.9g}"
    if kind == "torque":
        assert problem.actuation is not None  # checked when the problem was made
        weighted = bool((problem.actuation.weight != 1.0).any())
        law = "½ tauᵀ W tau" if weighted else "½‖tau‖²"
        law += f" + ½·{problem.objective.force_weight:g}·‖f‖²" if problem.objective.force_weight else ""
        moments = _moment_text(problem) if problem.objective.force_weight else ""
        return Text(f"Objective: {law} = {value}{'' if weighted else ' (N·m)²'}{moments}")
    words = {
        "force": f"½‖f‖² = {value} N²{_moment_text(problem)}",
        "max_normal": f"largest normal force = {value} N",
        "sum_normal": f"sum of normal forces = {value} N",
        "margin": f"common slip margin s = {value} N",
    }
    return Text(f"Objective: {words[kind]}")


def _moment_text(problem: ForceProblem) -> str:
    """Return the length that weighs moments in ‖f‖², with a comma; empty without soft contacts."""
    is_soft = ContactModel.SOFT in problem.contacts.models
    return f", moments divided by {problem.objective.moment_length:g} m" if is_soft else ""


def _infeasibility_lines(problem: ForceProblem, why: Infeasibility) -> Iterator[RenderableType]:
    """Yield the explanation of infeasibility, and the changes that would make the problem feasible."""
    yield Text(why.explanation)
    yield ""
    yield Text("Feasible with one of:", style="bold")
    if _has_friction(problem):
        yield Text(f"  friction: {_factor(why.friction_factor, 'all friction coefficients')}")
    if problem.actuation is not None:
        yield Text(f"  motors:   {_factor(why.torque_factor, 'all torque limits')}")
    if why.nearest_wrench is None:
        yield Text("  wrench:   no feasible wrench found")
    else:
        yield Text(f"  wrench:   {_wrench(why.nearest_wrench)} (the nearest feasible)")


def _factor(factor: float | None, what: str) -> str:
    return f"no factor on {what} found" if factor is None else f"{what} × {factor:.6g}"


def _certificate_text(status: Status, certificate: Certificate) -> str:
    """Return the certificate as a sentence. Its figures are relative to the problem's own force, length and cost."""
    primal, dual, gap = (f"{figure:.1e}" if figure else "0" for figure in _figures(certificate))
    if not certificate.verified:
        return f"Not verified: residuals {primal} and {dual}, gap {gap}."
    if status is Status.INFEASIBLE:
        return f"Verified: the limits contradict each other by {gap}; residual of the proof {dual}."
    return (
        f"Verified: primal residual {primal}, dual residual {dual}, gap {gap}, "
        f"relative to the scale of the problem (tolerance {certificate.tolerance:.0e})."
    )


def _figures(certificate: Certificate) -> tuple[float, float, float]:
    return certificate.primal_residual, certificate.dual_residual, certificate.gap


def make_table(columns: Sequence[tuple[str, Iterable[str]]], left: int = 1) -> Table:
    """Return a table; the first ``left`` columns are aligned left, the others right."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for i, (title, _) in enumerate(columns):
        table.add_column(title, justify="left" if i < left else "right", overflow="fold")
    for row in zip(*(values for _, values in columns), strict=True):
        table.add_row(*row)
    return table


def _numbers(values: Array, shown: Sequence[bool] | None = None, largest: float | None = None) -> list[str]:
    """Return a column of numbers with equal decimals; hidden values are dashes.

    ``largest`` sets the decimals of several columns; by default the largest number of the column does.
    """
    largest = float(np.abs(values).max(initial=0.0)) if largest is None else largest
    exponent = math.floor(math.log10(largest)) if largest > 0 else 0
    decimals = max(_DIGITS - 1 - exponent, 0)
    plain = -4 <= exponent < _DIGITS + 1
    texts = [f"{value:.{decimals}f}" if plain else f"{value:.{_DIGITS - 1}e}" for value in values]
    texts = [text.lstrip("-") if not float(text) else text for text in texts]  # no −0.0000
    return texts if shown is None else [text if show else NO_VALUE for text, show in zip(texts, shown, strict=True)]


def range_text(lower: float, upper: float) -> str:
    """Return an interval as text; a missing limit is left open."""
    low, high = (f"{x:.4g}" if math.isfinite(x) else "" for x in (lower, upper))
    return f"{low} … {high}".strip() if low or high else NO_VALUE


def _percent(share: float) -> str:
    return f"{100 * min(share, 9.99):.0f} %" if share >= _AT_LIMIT else f"{100 * share:.1f} %"


def _wrench(w: Array) -> str:
    """Return a wrench with units; rounding errors are shown as zero."""
    clean = np.where(np.abs(w) < _ROUNDING * np.abs(w).max(), 0.0, w)
    force, moment = (", ".join(f"{x:.5g}" for x in part) for part in (clean[:3], clean[3:]))
    return f"force ({force}) N, moment ({moment}) N·m"


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms" if seconds < 1.0 else f"{seconds:.3g} s"


def count_text(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
