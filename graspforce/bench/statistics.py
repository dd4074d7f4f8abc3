"""Statistics of outcomes: rates, shifted geometric means, performance profiles, speed-up by warm starts."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from graspforce.bench.judge import CLAIMED_VERDICTS, Verdict
from graspforce.bench.outcome import RaceOutcome

SHIFT = 1e-4  # s; differences far below it have little weight in the mean
VERDICTS = tuple(Verdict)


@dataclass(frozen=True, slots=True)
class OutcomeGroup:
    """Comparable outcomes: the same kind of cone, in the same units and settings.

    Args:
        settings: accuracy settings of all outcomes.
        units: units of all outcomes.
        pyramid: whether the problems have pyramids; otherwise exact cones.
        outcomes: outcomes of cold runs.
    """

    settings: str
    units: str
    pyramid: bool
    outcomes: tuple[RaceOutcome, ...]

    @property
    def solvers(self) -> tuple[str, ...]:
        """Return the solvers of the group, in the order of the race."""
        return tuple(dict.fromkeys(outcome.task.solver for outcome in self.outcomes))

    @property
    def reported_solvers(self) -> frozenset[str]:
        """Return the solvers whose times were reported and not measured here."""
        return frozenset(outcome.task.solver for outcome in self.outcomes if outcome.time_is_reported)


@dataclass(frozen=True, slots=True)
class SolverSummary:
    """Summary of one solver on the cases of a group.

    Args:
        solver: name of the solver.
        attempted: number of cases.
        claimed: number of cases that the solver reported solved or infeasible.
        counts: number of cases for each verdict.
        mean: shifted geometric mean of time, s, over the feasible cases that all solvers of the group support; a case without
            a correct solution counts as the limit.
        median: median time of the correct solutions, s; NaN without any.
    """

    solver: str
    attempted: int
    claimed: int
    counts: dict[Verdict, int]
    mean: float
    median: float


@dataclass(frozen=True, slots=True)
class WarmStartGain:
    """Speed-up by warm starts along sequences: medians over the steps where the cold and the warm solution are correct.

    Only steps with a previous solution count. The cold time is that of a cold run just before the warm one.

    Args:
        solver: name of the solver.
        pyramid: whether the problems have pyramids; otherwise exact cones.
        steps: number of steps.
        speedup: cold time over warm time.
        cold_iterations: number of iterations of cold runs.
        warm_iterations: number of iterations of warm runs.
    """

    solver: str
    pyramid: bool
    steps: int
    speedup: float
    cold_iterations: float
    warm_iterations: float


def group_outcomes(outcomes: Iterable[RaceOutcome]) -> list[OutcomeGroup]:
    """Group the cold outcomes by settings, units and kind of cone.

    Args:
        outcomes: outcomes of a race.
    """
    groups: dict[tuple[str, str, bool], list[RaceOutcome]] = {}
    for outcome in outcomes:
        task = outcome.task
        if not task.warm:
            groups.setdefault((task.settings, task.units, task.pyramid), []).append(outcome)
    return [OutcomeGroup(*key, tuple(own)) for key, own in groups.items()]


def summarize_solvers(group: OutcomeGroup, limit: float) -> list[SolverSummary]:
    """Return one summary for each solver of a group.

    Args:
        group: the outcomes.
        limit: time that replaces a missing correct solution, s.
    """
    common = common_cases(group)
    summaries = []
    for solver in group.solvers:
        own = [outcome for outcome in group.outcomes if outcome.task.solver == solver]
        counts = {verdict: sum(outcome.judgement.verdict is verdict for outcome in own) for verdict in VERDICTS}
        claimed = sum(counts[verdict] for verdict in CLAIMED_VERDICTS)
        times = [limit if o.seconds is None else o.seconds for o in own if o.feasible and o.task.case in common]
        solved = [o.seconds for o in own if o.feasible and o.seconds is not None]
        median = statistics.median(solved) if solved else math.nan
        summaries.append(SolverSummary(solver, len(own), claimed, counts, shifted_mean(times), median))
    return summaries


def common_cases(group: OutcomeGroup) -> frozenset[str]:
    """Return the cases that every solver of a group attempted and supports. Handed-in answers do not make them fewer.

    Args:
        group: the outcomes.
    """
    reported = group.reported_solvers
    here = [solver for solver in group.solvers if solver not in reported] or group.solvers
    supported: dict[str, set[str]] = {solver: set() for solver in here}
    for outcome in group.outcomes:
        if outcome.judgement.verdict is not Verdict.UNSUPPORTED and outcome.task.solver in supported:
            supported[outcome.task.solver].add(outcome.task.case)
    return frozenset(set.intersection(*supported.values())) if supported else frozenset()


def shifted_mean(times: Sequence[float], shift: float = SHIFT) -> float:
    """Return the shifted geometric mean exp(mean log(t + shift)) − shift; NaN without times.

    Args:
        times: (n,) times, s.
        shift: shift, s.
    """
    return math.exp(statistics.fmean(math.log(t + shift) for t in times)) - shift if times else math.nan


def feasible_cases(group: OutcomeGroup, common: bool) -> frozenset[str]:
    """Return the feasible cases of a group.

    Args:
        group: the outcomes.
        common: whether to return only the cases that every solver of the group attempted and supports.
    """
    feasible = frozenset(outcome.task.case for outcome in group.outcomes if outcome.feasible)
    return feasible & common_cases(group) if common else feasible


def performance_profile(group: OutcomeGroup, common: bool = True) -> dict[str, list[float]]:
    """Return for each solver the sorted ratios of its time to the shortest time, over feasible cases.

    The profile at τ is the share of ratios ≤ τ (Dolan and Moré 2002). Times that were not measured here do not count as the
    shortest one. Without a correct solution the ratio is infinite, also for cases that the solver does not support or did not
    attempt.

    Args:
        group: the outcomes.
        common: whether to include only the cases that every solver of the group attempted and supports.
    """
    cases = feasible_cases(group, common)
    times: dict[str, dict[str, float]] = {case: {} for case in sorted(cases)}
    for outcome in group.outcomes:
        if outcome.task.case in cases and outcome.seconds is not None:
            times[outcome.task.case][outcome.task.solver] = outcome.seconds
    reported = group.reported_solvers
    measured = {case: [time for solver, time in own.items() if solver not in reported] for case, own in times.items()}
    best = {case: min(measured[case] or own.values(), default=math.inf) for case, own in times.items()}
    return {
        solver: sorted(own[solver] / best[case] if solver in own else math.inf for case, own in times.items())
        for solver in group.solvers
    }


def times_by_contacts(group: OutcomeGroup, collection: str = "scaling") -> dict[str, list[tuple[int, float]]]:
    """Return for each solver the median time of correct solutions, s, by number of contacts.

    Args:
        group: the outcomes.
        collection: collection of the cases.
    """
    times: dict[str, dict[int, list[float]]] = {solver: {} for solver in group.solvers}
    for outcome in group.outcomes:
        if outcome.task.case.startswith(f"{collection}/") and outcome.seconds is not None:
            times[outcome.task.solver].setdefault(outcome.contacts, []).append(outcome.seconds)
    return {
        solver: [(contacts, statistics.median(seconds)) for contacts, seconds in sorted(own.items())]
        for solver, own in times.items()
    }


def median_accuracy(group: OutcomeGroup) -> dict[str, tuple[float, float]]:
    """Return for each solver the medians of time, s, and of the residual, over its correct solutions.

    Args:
        group: the outcomes.
    """
    medians = {}
    for solver in group.solvers:
        own = [o for o in group.outcomes if o.task.solver == solver and o.feasible and o.seconds is not None]
        if own:
            times = [_value_or_zero(o.seconds) for o in own]
            residuals = [_value_or_zero(o.judgement.residual) for o in own]
            medians[solver] = (statistics.median(times), statistics.median(residuals))
    return medians


def _value_or_zero(value: float | None) -> float:
    return 0.0 if value is None else value


def warm_start_gains(outcomes: Sequence[RaceOutcome]) -> list[WarmStartGain]:
    """Return the speed-up by warm starts for each solver that supports them, in default settings and scaled units.

    Args:
        outcomes: outcomes of a race.
    """
    cold_outcomes = {_case_key(o): o for o in outcomes if not o.task.warm}
    pairs: dict[tuple[str, bool], list[tuple[RaceOutcome, RaceOutcome]]] = {}
    for warm in (o for o in outcomes if o.task.warm and o.cold is not None and o.seconds is not None):
        cold, plain = cold_outcomes.get(_case_key(warm)), (warm.task.settings, warm.task.units) == ("default", "scaled")
        if plain and cold is not None and cold.seconds is not None:
            pairs.setdefault((warm.task.solver, warm.task.pyramid), []).append((cold, warm))
    return [
        WarmStartGain(
            solver,
            pyramid,
            len(own),
            _median(own, lambda _, warm: (warm.cold or math.nan) / (warm.seconds or math.nan)),
            _median(own, lambda cold, _: cold.iterations),
            _median(own, lambda _, warm: warm.iterations),
        )
        for (solver, pyramid), own in pairs.items()
    ]


def _case_key(outcome: RaceOutcome) -> tuple[str, str, str, bool, str]:
    task = outcome.task
    return task.solver, task.settings, task.units, task.pyramid, task.case


def _median(pairs: Sequence[tuple[RaceOutcome, RaceOutcome]], value: Callable[[RaceOutcome, RaceOutcome], float]) -> float:
    return float(statistics.median(value(cold, warm) for cold, warm in pairs))


def compare_races(
    before: Iterable[RaceOutcome], now: Iterable[RaceOutcome]
) -> tuple[list[tuple[RaceOutcome, RaceOutcome]], dict[str, float]]:
    """Return the outcomes whose verdicts differ between two races, and the median ratio of times by solver, now over before.

    Args:
        before: outcomes of the earlier race.
        now: outcomes of the later race.
    """
    earlier = {outcome.task: outcome for outcome in before}
    changed: list[tuple[RaceOutcome, RaceOutcome]] = []
    ratios: dict[str, list[float]] = {}
    shared = [(earlier[outcome.task], outcome) for outcome in now if outcome.task in earlier]
    for old, new in shared:
        if old.judgement.verdict is not new.judgement.verdict:
            changed.append((old, new))
        if old.seconds is not None and new.seconds is not None:
            ratios.setdefault(new.task.solver, []).append(new.seconds / old.seconds)
    return changed, {solver: statistics.median(own) for solver, own in ratios.items()}
