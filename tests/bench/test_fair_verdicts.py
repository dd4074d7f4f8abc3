"""Tests of the suite as a whole: two runs agree, and forces without multipliers are judged by themselves on the smoke set."""

from __future__ import annotations

import numpy as np
import pytest

import graspforce as gf
from graspforce import problems
from graspforce.bench.adapter import SolverResult, SolverStatus
from graspforce.bench.case_program import case_program, load_error
from graspforce.bench.judge import Verdict, judge
from graspforce.bench.race import make_race_plan, run
from graspforce.bench.statistics import compare_races

CASES = tuple(name for name in problems.smoke_names() if isinstance(problems.load(name).expected, problems.ExpectedOptimum))
# cases whose load is 1/10 to 1/100 of the unit of force
SMALL_LOADS = (
    "closed-loop/real-06-090",
    "ist/large-blue-box-long-side-lateral-tripod-minus-x-dlr-hit2",
    "pyramid/outer-8-margin-3",
    "soft/soft-margin-6",
    "soft/soft-margin-9",
)


def answers() -> list[tuple[problems.Case, gf.Solution]]:
    """Return the feasible cases of the smoke set, solved."""
    return [(case, gf.solve(case.problem, explain=False)) for case in map(problems.load, CASES)]


@pytest.mark.parametrize("settings", ["default", "high"])
def test_exact_forces_without_multipliers_are_never_wrong(settings: str) -> None:
    for case, answer in answers():
        found = judge(case.problem, True, SolverResult(SolverStatus.SOLVED, answer.f, None, 1), settings, case.expected)
        assert found.verdict is Verdict.CORRECT, (case.name, found)


@pytest.mark.parametrize("name", [*CASES, *SMALL_LOADS])
def test_optimum_scaled_by_a_thousandth_is_wrong_at_high_settings(name: str) -> None:
    """Also where the load is small beside the forces that motors or limits of normal forces determine."""
    case = problems.load(name)
    answer = gf.solve(case.problem, explain=False)
    for multipliers in (answer.multipliers, None):
        result = SolverResult(SolverStatus.SOLVED, 1.001 * answer.f, multipliers, 1)
        assert judge(case.problem, True, result, "high", case.expected).verdict is Verdict.WRONG


@pytest.mark.parametrize("name", SMALL_LOADS)
def test_errors_within_the_requested_tolerance_are_not_wrong(name: str) -> None:
    """An error of 1e-10 on the rows of the program is accepted, however small the load."""
    case = problems.load(name)
    answer, program = gf.solve(case.problem, explain=False), case_program(case.problem)
    step = program.forces(np.linalg.lstsq(program.A, np.full(len(program.b), 1e-10), rcond=None)[0])
    result = SolverResult(SolverStatus.SOLVED, answer.f + step, None, 1)
    assert judge(case.problem, True, result, "high", case.expected).verdict is Verdict.CORRECT


def test_missing_load_is_relative_to_the_load() -> None:
    problem = problems.load("ring/3-torque").problem
    f = gf.solve(problem, explain=False).f
    assert load_error(problem, 0.75 * f) == pytest.approx(0.25)
    assert load_error(problem, f) < 1e-9
    assert load_error(problem.replace(w=np.zeros(6)), f) == 0.0
    assert load_error(problem, np.full(len(f), 1e308)) > 1e300


def test_two_runs_have_equal_verdicts_but_for_those_named_as_varying() -> None:
    cases = (*problems.smoke_names()[::16], "infeasible/ball-01", "robust/mass-02")
    plan = make_race_plan(("structured", "clarabel", "proxqp"), units=("si",), limit=2.0, cases=cases)
    first, second = run(plan)[1], run(plan)[1]
    assert [one.task for one in first] == [one.task for one in second]
    changed, _ = compare_races(first, second)
    assert [
        (old.task, old.judgement, new.judgement) for old, new in changed if not (old.verdict_varies or new.verdict_varies)
    ] == []
