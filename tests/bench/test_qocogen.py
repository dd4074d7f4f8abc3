"""Tests of QOCOGEN, whose code is generated and compiled for each pattern of zeros."""

from __future__ import annotations

import pytest

from graspforce import problems
from graspforce.bench.adapter import SolverStatus
from graspforce.bench.case_program import case_program
from graspforce.bench.generated_code import code_folder
from graspforce.bench.judge import Verdict, judge
from graspforce.bench.registry import BY_NAME_ONLY, SOLVERS, installed_solvers
from graspforce.core.errors import UnsupportedProblem

pytest.importorskip("qocogen", reason="pip install qocogen")
adapter = pytest.importorskip("graspforce.bench.solvers.qocogen", reason="QOCOGEN needs a C compiler, cc")


def test_compiled_code_solves_programs_with_the_same_pattern() -> None:
    """The first and the second program have the same zeros and other numbers, so that one code solves both."""
    folders = []
    for name in ("ring/3-force", "ring/3-torque"):
        case = problems.load(name)
        bound = adapter.bind(case_program(case.problem), "default")
        folders.append(sorted(code_folder("qocogen").iterdir()))
        result = bound.read(bound.run(None))
        assert result.status is SolverStatus.SOLVED
        assert judge(case.problem, True, result, "default", case.expected).verdict is Verdict.CERTIFIED
    assert folders[0] == folders[1]


def test_infeasible_problem_has_no_answer() -> None:
    case = problems.load("ring/3-slippery")
    bound = adapter.bind(case_program(case.problem), "default")
    assert bound.read(bound.run(None)).status is SolverStatus.NO_ANSWER


def test_large_code_is_not_compiled() -> None:
    with pytest.raises(UnsupportedProblem, match="compiled for at most 40 variables"):
        adapter.bind(case_program(problems.load("scaling/0030-force-1").problem), "default")


def test_solvers_that_compile_take_part_by_name_only() -> None:
    assert "qocogen" in SOLVERS
    assert not set(installed_solvers()) & set(BY_NAME_ONLY)
