"""Tests of the baselines: forces without multipliers are never wrong, and cones as smooth inequalities are the cones."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce import problems
from graspforce.bench.judge import Verdict, judge
from graspforce.bench.registry import load_adapter
from graspforce.bench.smooth_cones import cone_heads, cone_parts, interior_start
from graspforce.force.cone_program import conic_program
from graspforce.problems import ExpectedOptimum


def test_exact_forces_without_multipliers_are_never_wrong() -> None:
    """SLSQP on small cases with strictly convex costs, where its test of convergence implies the optimum."""
    adapter = load_adapter("slsqp")
    counts: dict[Verdict, int] = {}
    every = [problems.load(name) for name in problems.names("textbook")]
    cases = [case for case in every if case.problem.objective.type == "force" and len(case.problem.contacts) <= 5]
    for case in cases:
        entry = adapter.bind(conic_program(case.problem), "high")
        feasible = isinstance(case.expected, ExpectedOptimum)
        result = entry.read(entry.run(None))
        assert result.multipliers is None
        found = judge(case.problem, feasible, result, "high", case.expected if feasible else None)
        counts[found.verdict] = counts.get(found.verdict, 0) + 1
    assert set(counts) <= {Verdict.CORRECT, Verdict.NO_ANSWER, Verdict.INEXACT}
    assert counts[Verdict.CORRECT] > len(cases) / 2


@pytest.mark.parametrize("name", ["ring/3-torque", "nose-cone/5-margin", "soft/grasp-01"])
def test_start_is_strictly_inside_cones_that_can_move_freely(name: str) -> None:
    names = problems.names(name.split("/")[0])
    program = conic_program(problems.load(name if name in names else names[0]).problem)
    x = interior_start(program)
    S, r = cone_heads(program)
    heads = r - S @ x
    assert np.all(heads > 0.0)
    for head, (rows, right) in zip(heads, cone_parts(program), strict=True):
        value = right - rows @ x
        assert value[0] == head
        assert np.linalg.norm(value[1:]) < head
