"""Tests of the verdicts: forces are judged by themselves, and false answers are found."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.linalg import null_space

import graspforce as gf
from graspforce import problems
from graspforce.bench import conditions
from graspforce.bench.adapter import SolverResult, SolverStatus, make_result
from graspforce.bench.case_program import case_program
from graspforce.bench.judge import TRUE_CLAIM, WRONG_RESIDUAL, Verdict, cost_excess, judge, proven_optimum
from graspforce.problems import ExpectedOptimum

# every objective, exact cones and pyramids, soft fingers, motor limits
CASES = ("opposed/torque-weight", "ring/3-force", "ring/3-torque", "nose-cone/5-force", "pyramid/inner-8-torque-1")


def solved(f: np.ndarray, multipliers: gf.Multipliers | None = None) -> SolverResult:
    return SolverResult(SolverStatus.SOLVED, f, multipliers, 1)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("settings", ["default", "high", "low"])
def test_optimal_forces_are_correct_without_multipliers(case: str, settings: str) -> None:
    known = problems.load(case)
    f = gf.solve(known.problem).f
    assert judge(known.problem, True, solved(f), settings, known.expected).verdict is Verdict.CORRECT
    assert judge(known.problem, True, solved(f), settings).verdict is Verdict.CORRECT  # against an optimum computed here


@pytest.mark.parametrize("objective", ["force", "torque", "max_normal", "sum_normal", "margin"])
def test_cost_is_compared_in_the_direction_of_the_objective(objective: str) -> None:
    """Every feasible problem of the library with this objective: the optimum has no excess, a better bound has one."""
    names = [name for name in problems.names("textbook") if problems.load(name).problem.objective.type == objective]
    known = [case for case in map(problems.load, names) if isinstance(case.expected, ExpectedOptimum)]
    assert known
    for case in known:
        f, optimum = gf.solve(case.problem).f, case.expected
        assert cost_excess(case.problem, f, optimum) <= 1e-9
        size = abs(optimum.objective) or 1.0
        better = optimum.objective + (0.1 if objective == "margin" else -0.1) * size
        assert cost_excess(case.problem, f, dataclasses.replace(optimum, objective=better)) > 1e-6


def test_optimum_scaled_by_a_thousandth_is_wrong_at_high_settings() -> None:
    for case in CASES:
        known = problems.load(case)
        answer = gf.solve(known.problem)
        for multipliers in (answer.multipliers, None):
            found = judge(known.problem, True, solved(1.001 * answer.f, multipliers), "high", known.expected)
            assert found.verdict is Verdict.WRONG, case
            assert judge(known.problem, True, solved(1.001 * answer.f, multipliers), "low").verdict in (
                Verdict.CERTIFIED,
                Verdict.CORRECT,
                Verdict.UNVERIFIED,
            )


def test_wrong_multipliers_do_not_make_correct_forces_wrong() -> None:
    known = problems.load("opposed/torque-weight")
    answer = gf.solve(known.problem)
    doubled = dataclasses.replace(answer.multipliers, y=2.0 * answer.multipliers.y)
    found = judge(known.problem, True, solved(answer.f, doubled), "default", known.expected)
    assert found.verdict is Verdict.UNVERIFIED
    assert found.residual > 1e-2  # the residual of the certificate
    assert found.is_correct


def mutate(rng: np.random.Generator, problem: gf.ForceProblem, answer: gf.Solution, kind: int) -> SolverResult:
    """Return a false answer: forces scaled, disturbed, squeezed harder or shifted between contacts, or a false status."""
    f, size = answer.f, float(np.linalg.norm(answer.f))
    step = 10.0 ** rng.uniform(-2.5, 0.0)
    if kind == 0:
        return solved(f * (1.0 + rng.choice([-1.0, 1.0]) * step), answer.multipliers)
    if kind == 1:
        return solved(f + step * size * rng.normal(size=len(f)) / np.sqrt(len(f)))
    if kind == 2:  # internal forces: equilibrium holds, the cost or a cone does not
        internal = null_space(problem.G)
        direction = internal @ rng.normal(size=internal.shape[1])
        return solved(f + max(step, 0.1) * size * direction / np.linalg.norm(direction))
    if kind == 3:
        i = int(rng.integers(len(f)))
        return solved(np.where(np.arange(len(f)) == i, f + step * size, f), answer.multipliers)
    return SolverResult(SolverStatus.INFEASIBLE, None, dataclasses.replace(answer.multipliers, y=rng.normal(size=6)), 1)


def test_thousand_mutated_answers_are_rejected() -> None:
    """Problems with a unique optimum: every other answer is inexact or wrong, and a false infeasibility is wrong."""
    rng = np.random.default_rng(20)
    known = [problems.load(name) for name in ("opposed/torque-weight", "ring/3-force", "nose-cone/5-force", "ring/3-torque")]
    answers = [gf.solve(case.problem) for case in known]
    for i in range(1000):
        case, answer = known[i % 4], answers[i % 4]
        kind = (i // 4) % 5
        verdict = judge(case.problem, True, mutate(rng, case.problem, answer, kind), "high", case.expected).verdict
        assert verdict in (Verdict.WRONG, Verdict.INEXACT), (i, case.name, kind)
        assert verdict is Verdict.WRONG or kind == 2, (i, case.name, kind)  # the cost grows with the square of the step


def program_result(problem: gf.ForceProblem, x: np.ndarray) -> SolverResult:
    """Return the result of a solver that reports x as optimal, without multipliers."""
    return make_result(case_program(problem), SolverStatus.SOLVED, x, None, None, 1)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("settings", ["default", "high", "low"])
def test_row_error_of_an_answer_is_that_of_its_rows(case: str, settings: str) -> None:
    """The optimum has none; an answer moved by t off its equations has t, relative to the numbers of the program."""
    problem = problems.load(case).problem
    program = case_program(problem)
    x = program.variables(gf.solve(problem).f)
    assert program_result(problem, x).row_error <= 1e-9
    off = np.linalg.lstsq(program.A, np.full(len(program.b), 1e-3), rcond=None)[0]
    largest = max(
        float(np.abs(part).max(initial=0.0)) for part in (program.b, program.d, program.r, program.S @ x, program.C @ x)
    )
    moved = program_result(problem, x + off).row_error
    assert moved >= 1e-3 / (1.0 + max(1.0, 2.0 * largest))
    assert moved <= 1e-3 * (1.0 + float(np.abs(off).max()) / 1e-3)


@pytest.mark.parametrize(("settings", "claim"), TRUE_CLAIM.items())
def test_forces_far_from_the_cones_are_wrong_only_if_the_rows_of_the_solver_are_violated(settings: str, claim: float) -> None:
    """Where friction is tiny, an error of the rows within the tolerance moves the forces far out of their cones."""
    case = problems.load("ring/3-force")
    f = 1.5 * gf.solve(case.problem).f
    for row_error, verdict in ((0.5 * claim, Verdict.INEXACT), (2.0 * claim, Verdict.WRONG), (None, Verdict.WRONG)):
        found = judge(case.problem, True, dataclasses.replace(solved(f), row_error=row_error), settings, case.expected)
        assert found.residual > WRONG_RESIDUAL[settings]
        assert found.verdict is verdict


def test_ray_that_excludes_forces_to_the_accepted_residual_is_inexact() -> None:
    """With friction of 1e-3 a load across the normals needs forces of a thousand times its size."""
    contacts = gf.ContactSet.stack([gf.Contact([s, 0, 0], [-s, 0, 0], 1e-4) for s in (1.0, -1.0)])
    problem = gf.ForceProblem(contacts, [0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    ray = gf.Multipliers(
        np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), *np.zeros((2, 2)), *np.zeros((2, 0)), np.zeros(2), np.zeros(3)
    )
    claim = SolverResult(SolverStatus.INFEASIBLE, None, ray, 1)
    assert judge(problem, True, claim, "low").verdict is Verdict.INEXACT
    assert judge(problem, True, claim, "high").verdict is Verdict.WRONG
    other = dataclasses.replace(ray, y=np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert judge(problem, True, dataclasses.replace(claim, multipliers=other), "low").verdict is Verdict.WRONG


def test_forces_that_do_not_hold_an_infeasible_load_are_wrong() -> None:
    case = problems.load("opposed/capped")
    assert judge(case.problem, False, solved(np.zeros(case.problem.size)), "default").verdict is Verdict.WRONG


def test_optimum_of_an_infeasible_problem_is_an_error() -> None:
    with pytest.raises(gf.GraspForceError, match="could not be certified"):
        proven_optimum(problems.load("opposed/capped").problem)


def test_clock_sentence_states_governor_rates_and_throttling() -> None:
    state = {"governor": "powersave", "mhz": 3000.0, "throttle_count": None}
    slow = {**state, "mhz": 2000.0}
    sentence = conditions.clock_sentence({"before": state, "after": slow})
    assert sentence == (
        "Clock: governor powersave, 3000 MHz before and 2000 MHz after; throttling events not counted, slower at the end."
    )
    counted = [{**state, "throttle_count": count} for count in (3, 8)]
    assert conditions.clock_sentence({"before": counted[0], "after": counted[1]}).endswith("; 5 throttling events.")
    unknown = {"governor": None, "mhz": None, "throttle_count": None}
    assert (
        conditions.clock_sentence({"before": unknown, "after": unknown}) == "Clock: governor not reported, rate not reported."
    )
    assert set(conditions.clock_state()) == set(state)
