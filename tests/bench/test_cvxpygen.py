"""Tests of CVXPYgen, whose code is generated and compiled for each pattern of zeros."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce import problems
from graspforce.bench.adapter import SolverStatus
from graspforce.bench.case_program import case_program
from graspforce.bench.generated_code import code_folder
from graspforce.bench.judge import Verdict, judge
from graspforce.bench.registry import BY_NAME_ONLY, SOLVERS
from graspforce.core.errors import UnsupportedProblem

pytest.importorskip("cvxpygen", reason="pip install cvxpygen")
adapter = pytest.importorskip("graspforce.bench.solvers.cvxpygen", reason="CVXPYgen needs a C compiler, cc")


def test_compiled_code_solves_programs_with_the_same_pattern() -> None:
    """The programs have the same zeros and other numbers, P included, so that one code solves all, in any order."""
    folders = []
    for name in ("ring/3-force", "ring/3-torque", "ring/3-load-moment", "ring/3-force"):
        case = problems.load(name)
        bound = adapter.bind(case_program(case.problem), "default")
        folders.append(sorted(code_folder("cvxpygen").iterdir()))
        result = bound.read(bound.run(None))
        assert result.status is SolverStatus.SOLVED
        assert judge(case.problem, True, result, "default", case.expected).verdict is Verdict.CERTIFIED
    assert folders[0] == folders[-1]


@pytest.mark.parametrize("name", ["ring/4-margin", "ring/3-max-normal", "ring/3-inner-8", "scaling/0003-torque-1"])
def test_every_kind_of_program_is_solved(name: str) -> None:
    """Programs with a linear cost, with one row only, without cones, and with a cost that couples variables."""
    case = problems.load(name)
    bound = adapter.bind(case_program(case.problem), "default")
    result = bound.read(bound.run(None))
    assert judge(case.problem, True, result, "default", case.expected).verdict is Verdict.CERTIFIED


def test_square_root_of_the_cost_has_the_blocks_of_the_cost() -> None:
    program = case_program(problems.load("scaling/0003-torque-1").problem)
    matrices, patterns = adapter._matrices(program)
    root = np.zeros_like(program.P)
    root[patterns["L"]] = matrices["L"][patterns["L"]]
    assert np.allclose(root.T @ root, program.P, atol=1e-12)
    assert len(patterns["L"][0]) < program.P.size


def test_infeasible_problem_is_proven_infeasible() -> None:
    case = problems.load("ring/4-capped")
    bound = adapter.bind(case_program(case.problem), "default")
    result = bound.read(bound.run(None))
    assert result.status is SolverStatus.INFEASIBLE
    assert judge(case.problem, False, result, "default").verdict is Verdict.CERTIFIED


def test_tighter_settings_take_more_iterations() -> None:
    program = case_program(problems.load("ring/3-force").problem)
    iterations = []
    for settings in ("low", "default", "high"):
        bound = adapter.bind(program, settings)
        iterations.append(bound.read(bound.run(None)).iterations)
    assert iterations == sorted(set(iterations))


def test_large_code_is_not_generated() -> None:
    with pytest.raises(UnsupportedProblem, match="generated for at most 100 variables"):
        adapter.bind(case_program(problems.load("scaling/0050-force-1").problem), "default")


def test_solver_takes_part_by_name_only() -> None:
    assert "cvxpygen" in SOLVERS
    assert "cvxpygen" in BY_NAME_ONLY
