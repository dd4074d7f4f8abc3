"""Outcomes summed up: rates, shifted geometric means, performance profiles, gains of warm starts. Pure functions."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from graspforce.bench.judge import Verdict
from graspforce.bench.outcome import RaceOutcome

SHIFT = 1e-4  # s: differences far below count for little in the mean
VERDICTS = tuple(Verdict)


@dataclass(frozen=True, slots=True)
class OutcomeGroup:
    """Outcomes that can be compared: the same problems in the same units and settings.

    Args:
        settings, units: of all.
        pyramid: whether they are pyramids; else exact cones.
        outcomes: of cold runs.
    """

    settings: str
    units: str
    pyramid: bool
    outcomes: tuple[RaceOutcome, ...]

    @property
    def solvers(self) -> tuple[str, ...]:
        """In the order of the race."""
        return tuple(dict.fromkeys(outcome.task.solver for outcome in self.outcomes))


@dataclass(frozen=True, slots=True)
class SolverSummary:
    """A solver on a group's cases.

    Args:
        solver: its name.
        asked: how many cases.
        claimed: of how many it says that it solved them, or that they have no answer.
        counts: how many of each verdict.
        mean: shifted geometric mean, s, over the feasible cases that no solver of the group refuses; a case without a
            certified answer counts as the limit.
        median: s, over the feasible cases that it has certified answers to; NaN without any.
    """

    solver: str
    attempted: int
    claimed: int
    counts: dict[Verdict, int]
    mean: float
    median: float


@dataclass(frozen=True, slots=True)
class WarmStartGain:
    """What a warm start brings along sequences, on the steps where both answers are certified: medians.

    A step counts that has an answer to start from; its cold time is that of a run just before the warm one.
    """

    solver: str
    pyramid: bool
    steps: int
    speedup: float
    cold_iterations: float
    warm_iterations: float


def group_outcomes(outcomes: Iterable[RaceOutcome]) -> list[OutcomeGroup]:
    """Group the cold outcomes by settings, units and kind of cone."""
    found: dict[tuple[str, str, bool], list[RaceOutcome]] = {}
    for outcome in outcomes:
        task = outcome.task
        if not task.warm:
            found.setdefault((task.settings, task.units, task.pyramid), []).append(outcome)
    return [OutcomeGroup(*key, tuple(own)) for key, own in found.items()]


def summarize_solvers(group: OutcomeGroup, limit: float) -> list[SolverSummary]:
    """One for each solver of a group.

    Args:
        group: the outcomes.
        limit: s, what a case without a certified answer counts as.
    """
    common = common_cases(group)
    found = []
    for solver in group.solvers:
        own = [outcome for outcome in group.outcomes if outcome.task.solver == solver]
        counts = {verdict: sum(outcome.judgement.verdict is verdict for outcome in own) for verdict in VERDICTS}
        claimed = sum(counts[v] for v in (Verdict.CERTIFIED, Verdict.UNPROVEN, Verdict.INEXACT, Verdict.WRONG))
        times = [limit if o.seconds is None else o.seconds for o in own if o.feasible and o.task.case in common]
        certified = [o.seconds for o in own if o.feasible and o.seconds is not None]
        median = statistics.median(certified) if certified else math.nan
        found.append(SolverSummary(solver, len(own), claimed, counts, shifted_mean(times), median))
    return found


def common_cases(group: OutcomeGroup) -> frozenset[str]:
    """Return the cases that every solver of a group attempted and supports."""
    taken: dict[str, set[str]] = {solver: set() for solver in group.solvers}
    for outcome in group.outcomes:
        if outcome.judgement.verdict is not Verdict.UNSUPPORTED:
            taken[outcome.task.solver].add(outcome.task.case)
    return frozenset(set.intersection(*taken.values())) if taken else frozenset()


def shifted_mean(times: Sequence[float], shift: float = SHIFT) -> float:
    """exp(mean log(t + shift)) − shift; NaN of nothing."""
    return math.exp(statistics.fmean(math.log(t + shift) for t in times)) - shift if times else math.nan


def performance_profile(group: OutcomeGroup) -> dict[str, list[float]]:
    """For every solver the sorted ratios of its time to the best one's, over the feasible cases that all take.

    Dolan and Moré (2002): the share of cases within a factor τ of the best is the count of ratios up to τ over all cases. A
    case without a certified answer has the ratio infinity.
    """
    common = common_cases(group)
    times: dict[str, dict[str, float]] = {}
    for outcome in group.outcomes:
        if outcome.feasible and outcome.task.case in common:
            seconds = math.inf if outcome.seconds is None else outcome.seconds
            times.setdefault(outcome.task.case, {})[outcome.task.solver] = seconds
    best = {case: min(own.values()) for case, own in times.items()}
    return {
        solver: sorted(own[solver] / best[case] if math.isfinite(best[case]) else math.inf for case, own in times.items())
        for solver in group.solvers
    }


def times_by_contacts(group: OutcomeGroup, collection: str = "scaling") -> dict[str, list[tuple[int, float]]]:
    """For every solver the median time of certified answers at each number of contacts of a collection."""
    found: dict[str, dict[int, list[float]]] = {solver: {} for solver in group.solvers}
    for outcome in group.outcomes:
        if outcome.task.case.startswith(f"{collection}/") and outcome.seconds is not None:
            found[outcome.task.solver].setdefault(outcome.contacts, []).append(outcome.seconds)
    return {
        solver: [(contacts, statistics.median(times)) for contacts, times in sorted(own.items())]
        for solver, own in found.items()
    }


def median_accuracy(group: OutcomeGroup) -> dict[str, tuple[float, float]]:
    """For every solver the medians of time, s, and residual, over the feasible cases that it has certified answers to."""
    found = {}
    for solver in group.solvers:
        own = [o for o in group.outcomes if o.task.solver == solver and o.feasible and o.seconds is not None]
        if own:
            times, residuals = ([_number(value) for value in column] for column in zip(*map(_pair, own), strict=True))
            found[solver] = (statistics.median(times), statistics.median(residuals))
    return found


def _pair(outcome: RaceOutcome) -> tuple[float | None, float | None]:
    return outcome.seconds, outcome.judgement.residual


def _number(value: float | None) -> float:
    return 0.0 if value is None else value


def warm_start_gains(outcomes: Sequence[RaceOutcome]) -> list[WarmStartGain]:
    """Return the gain of warm starts for each solver that has them, in default settings and scaled units."""
    cold = {_case_key(o): o for o in outcomes if not o.task.warm}
    pairs: dict[tuple[str, bool], list[tuple[RaceOutcome, RaceOutcome]]] = {}
    for warm in (o for o in outcomes if o.task.warm and o.cold is not None and o.seconds is not None):
        before, plain = cold.get(_case_key(warm)), (warm.task.settings, warm.task.units) == ("default", "scaled")
        if plain and before is not None and before.seconds is not None:
            pairs.setdefault((warm.task.solver, warm.task.pyramid), []).append((before, warm))
    return [
        WarmStartGain(
            solver,
            pyramid,
            len(own),
            _median(own, lambda _, b: (b.cold or math.nan) / (b.seconds or math.nan)),
            _median(own, lambda a, b: a.iterations),
            _median(own, lambda a, b: b.iterations),
        )
        for (solver, pyramid), own in pairs.items()
    ]


def _case_key(outcome: RaceOutcome) -> tuple[str, str, str, bool, str]:
    task = outcome.task
    return task.solver, task.settings, task.units, task.pyramid, task.case


def _median(pairs: Sequence[tuple[RaceOutcome, RaceOutcome]], of: Callable[[RaceOutcome, RaceOutcome], float]) -> float:
    return float(statistics.median(of(cold, warm) for cold, warm in pairs))


def compare_races(
    before: Iterable[RaceOutcome], now: Iterable[RaceOutcome]
) -> tuple[list[tuple[RaceOutcome, RaceOutcome]], dict[str, float]]:
    """Return the outcomes whose verdicts differ between two races, and the median ratio of times by solver."""
    old = {outcome.task: outcome for outcome in before}
    changed: list[tuple[RaceOutcome, RaceOutcome]] = []
    ratios: dict[str, list[float]] = {}
    shared = [(old[outcome.task], outcome) for outcome in now if outcome.task in old]
    for a, b in shared:
        if a.judgement.verdict is not b.judgement.verdict:
            changed.append((a, b))
        if a.seconds is not None and b.seconds is not None:
            ratios.setdefault(b.task.solver, []).append(b.seconds / a.seconds)
    return changed, {solver: statistics.median(own) for solver, own in ratios.items()}
