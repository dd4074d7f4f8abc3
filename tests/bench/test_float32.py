"""Tests of the float32 track: programs rounded to single precision, and only solvers that compute in it."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce import problems
from graspforce.bench.case_program import case_program
from graspforce.bench.judge import judge
from graspforce.bench.race import make_race_plan, race_tasks
from graspforce.bench.si_units import to_single_precision
from graspforce.bench.worker import load_proven_case

CASES = ("ring/3-force", "pyramid/inner-8-torque-1", "scaling/0010-force-1", "batch/pyramid-010")


def test_programs_have_numbers_of_single_precision() -> None:
    program = case_program(problems.load("ring/3-torque").problem)
    rounded = to_single_precision(program)
    for name in ("P", "q", "A", "b", "C", "d", "S", "r"):
        values, exact = getattr(rounded, name), getattr(program, name)
        assert (values == values.astype(np.float32)).all()
        assert values == pytest.approx(exact, rel=2.0**-24)
    assert not (rounded.A == program.A).all()


def test_only_solvers_with_single_precision_take_part() -> None:
    pytest.importorskip("qpax")
    plan = make_race_plan(("clarabel", "qpax"), ("default", "float32"), cases=("ring/3-force",))
    assert {(task.solver, task.settings) for task in race_tasks(plan)} == {
        ("clarabel", "default"),
        ("qpax", "default"),
        ("qpax", "float32"),
    }


@pytest.mark.parametrize("name", CASES)
def test_single_precision_reaches_its_accepted_residual(name: str) -> None:
    pytest.importorskip("qpax")
    from graspforce.bench.solvers import qpax

    problem, feasible, optimum = load_proven_case(name, True)
    bound = qpax.bind(to_single_precision(case_program(problem)), "float32")
    output = bound.run(None)
    assert output[0].dtype == np.float32
    judgement = judge(problem, feasible, bound.read(output), "float32", optimum)
    assert judgement.is_correct
    assert judgement.residual > 1e-10  # double precision leaves less
