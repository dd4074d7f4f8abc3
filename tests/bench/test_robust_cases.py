"""Tests of robust cases in the suite: their programs, and verdicts that count the worst errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import graspforce as gf
from graspforce import problems
from graspforce.bench.adapter import SolverResult, SolverStatus
from graspforce.bench.case_program import case_program, forces_residual
from graspforce.bench.judge import Verdict, judge
from graspforce.bench.registry import load_adapter
from graspforce.core.errors import UnsupportedProblem
from graspforce.force.robust_session import is_supported

KINDS = ("friction", "mass", "centre", "wrenches", "normals", "all")
CASES = tuple(f"robust/{kind}-{i:02}" for kind in KINDS for i in (1, 2, 4))


def solved(f: np.ndarray) -> SolverResult:
    return SolverResult(SolverStatus.SOLVED, f, None, 1)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("solver", ["clarabel", "qoco"])
def test_program_of_a_robust_case_has_the_proven_optimum(name: str, solver: str) -> None:
    case = problems.load(name)
    adapter = pytest.importorskip(f"graspforce.bench.solvers.{solver}")
    bound = adapter.bind(case_program(case.problem), "default")
    result = bound.read(bound.run(None))
    assert result.multipliers is None  # its multipliers belong to several cones per contact
    assert judge(case.problem, True, result, "default", case.expected).verdict is Verdict.CORRECT
    assert case.problem.cost(result.f) == pytest.approx(case.expected.objective, rel=1e-5)


@pytest.mark.parametrize("name", CASES)
def test_forces_without_regard_to_errors_are_wrong(name: str) -> None:
    """The optimum of the model without errors costs less, and slips for some of the errors."""
    case = problems.load(name)
    plain = gf.solve(dataclasses.replace(case.problem, uncertainty=None), explain=False)
    assert plain.objective <= case.expected.objective * (1.0 + 1e-7)
    residual = forces_residual(case.problem, plain.f)
    assert residual > 1e-4
    assert judge(case.problem, True, solved(plain.f), "high", case.expected).verdict is Verdict.WRONG
    assert forces_residual(case.problem, gf.solve(case.problem, explain=False).f) <= 1e-8


@pytest.mark.parametrize("kind", KINDS)
def test_structured_kernel_answers_robust_cases_with_the_proven_optimum(kind: str) -> None:
    """Its verdict is never wrong; cases whose contacts three errors limit have no answer."""
    answered, supported = 0, 0
    for name in problems.names("robust"):
        case = problems.load(name)
        if not name.startswith(f"robust/{kind}-") or not is_supported(case.problem):
            continue
        bound = load_adapter("structured").bind(case_program(case.problem), "high")
        result = bound.read(bound.run(None))
        supported += 1
        if result.status is SolverStatus.SOLVED:
            assert judge(case.problem, True, result, "high", case.expected).verdict is Verdict.CORRECT, name
            assert case.problem.cost(result.f) == pytest.approx(case.expected.objective, rel=1e-6), name
            answered += 1
    assert supported == 24
    assert answered >= (supported // 2 if kind in ("all", "centre", "wrenches") else supported)


def test_structured_kernel_does_not_support_robust_pyramids() -> None:
    case = problems.load("robust/mass-01").problem
    pyramid = dataclasses.replace(case, cone=gf.Cone("pyramid", 8, "inner"))
    with pytest.raises(UnsupportedProblem, match="exact cones"):
        load_adapter("structured").bind(case_program(pyramid), "default")


def test_errors_without_an_exact_program_are_unsupported() -> None:
    problem = problems.load("robust/friction-01").problem
    inexact = dataclasses.replace(problem, uncertainty=gf.Uncertainty(position_error=1e-3))
    with pytest.raises(UnsupportedProblem, match="not exact"):
        case_program(inexact)


def test_pyramids_of_robust_cases_are_linear_programs() -> None:
    for name in CASES:
        problem = dataclasses.replace(problems.load(name).problem, cone=gf.Cone("pyramid", 8, "inner"))
        assert case_program(problem).cones == ()
