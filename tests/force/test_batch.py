"""Batches of problems equal their problems one by one."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from support.random_problems import feasible_problem, random_problem

from graspforce import Status, solve, solve_batch
from graspforce.core.errors import UnknownName


def test_batch_keeps_its_order_and_equals_single_solutions():
    rng = np.random.default_rng(50)
    problems = [random_problem(rng) for _ in range(80)]
    answers = solve_batch(problems)
    assert {Status.OPTIMAL, Status.INFEASIBLE} <= {answer.status for answer in answers}
    for problem, answer in zip(problems, answers, strict=True):
        alone = solve(problem, explain=False)
        assert answer.status is alone.status
        assert answer.problem is problem
        assert np.array_equal(answer.f, alone.f)
    assert solve_batch([]) == ()
    with pytest.raises(UnknownName):
        solve_batch(problems, "nobody")


def test_batch_submits_chunks_of_problems(monkeypatch):
    """`ThreadPoolExecutor.map` ignores its argument chunksize, so that each problem would be a task of its own."""
    submitted = []
    submit = ThreadPoolExecutor.submit
    monkeypatch.setattr(ThreadPoolExecutor, "submit", lambda *args: submitted.append(args) or submit(*args))
    monkeypatch.setattr("graspforce.force.batch.core_count", lambda: 2)
    problems = [feasible_problem(1).replace(w=feasible_problem(1).w * (1 + 1e-4 * i)) for i in range(1000)]
    answers = solve_batch(problems)
    assert [answer.problem for answer in answers] == problems
    assert 16 <= len(submitted) <= 17  # eight chunks for each thread, and a remainder
