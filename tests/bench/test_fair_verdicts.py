"""Tests of the suite as a whole: two runs agree, and forces without multipliers are judged by themselves on the smoke set."""

from __future__ import annotations

import pytest

import graspforce as gf
from graspforce import problems
from graspforce.bench.adapter import SolverResult, SolverStatus
from graspforce.bench.judge import CORRECT_VERDICTS, Verdict, judge
from graspforce.bench.race import make_race_plan, run
from graspforce.bench.statistics import compare_races

CASES = tuple(name for name in problems.smoke_names() if isinstance(problems.load(name).expected, problems.ExpectedOptimum))


def answers() -> list[tuple[problems.Case, gf.Solution]]:
    """Return the feasible cases of the smoke set, solved."""
    return [(case, gf.solve(case.problem, explain=False)) for case in map(problems.load, CASES)]


@pytest.mark.parametrize("settings", ["default", "high"])
def test_exact_forces_without_multipliers_are_never_wrong(settings: str) -> None:
    for case, answer in answers():
        found = judge(case.problem, True, SolverResult(SolverStatus.SOLVED, answer.f, None, 1), settings, case.expected)
        assert found.verdict is Verdict.CORRECT, (case.name, found)


def test_optimum_scaled_by_a_thousandth_is_never_correct_at_high_settings() -> None:
    """It is wrong where the load is among the largest forces; a small load beside a large squeeze leaves a smaller residual."""
    wrong = 0
    for case, answer in answers():
        result = SolverResult(SolverStatus.SOLVED, 1.001 * answer.f, answer.multipliers, 1)
        found = judge(case.problem, True, result, "high", case.expected)
        assert found.verdict not in CORRECT_VERDICTS, (case.name, found)
        wrong += found.verdict is Verdict.WRONG
    assert wrong >= 0.9 * len(CASES)


def test_two_runs_have_equal_verdicts_but_for_those_named_as_varying() -> None:
    cases = (*problems.smoke_names()[::16], "infeasible/ball-01", "robust/mass-02")
    plan = make_race_plan(("structured", "clarabel", "proxqp"), units=("si",), limit=2.0, cases=cases)
    first, second = run(plan)[1], run(plan)[1]
    assert [one.task for one in first] == [one.task for one in second]
    changed, _ = compare_races(first, second)
    assert [
        (old.task, old.judgement, new.judgement) for old, new in changed if not (old.verdict_varies or new.verdict_varies)
    ] == []
