"""Batches and stacks of problems equal their problems one by one."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from support.random_problems import feasible_problem, random_problem

from graspforce import Cone, ForceProblem, InvalidInput, Objective, Status, solve, solve_batch, solve_stack
from graspforce.core.errors import BackendError, UnknownName


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
    monkeypatch.setattr("graspforce.force.batch._core_count", lambda: 2)
    problems = [feasible_problem(1).replace(w=feasible_problem(1).w * (1 + 1e-4 * i)) for i in range(1000)]
    answers = solve_batch(problems)
    assert [answer.problem for answer in answers] == problems
    assert 16 <= len(submitted) <= 17  # eight chunks for each thread, and a remainder


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_stack_equals_its_problems_one_by_one(threads):
    problem, rng = feasible_problem(1), np.random.default_rng(51)
    count = 600  # more than two chunks
    w = problem.w * (1 + 0.01 * rng.uniform(-1, 1, (count, 6)))
    J = problem.actuation.J * (1 + 0.01 * rng.uniform(-1, 1, (count, *problem.actuation.J.shape)))
    tau_u = problem.actuation.tau_u * (1 + 0.01 * rng.uniform(-1, 1, (count, 12)))
    w[7] *= 1e4  # infeasible
    stack = solve_stack(problem, w=w, J=J, tau_u=tau_u, threads=threads)
    assert stack.status[7] is Status.INFEASIBLE
    assert np.isnan(stack.f[7]).all()
    assert np.isnan(stack.torques[7]).all()
    for i in (0, 1, 255, 256, 511, 512, count - 1):
        alone = problem.replace(w=w[i], J=J[i], tau_u=tau_u[i])
        answer = solve(alone)
        assert stack.status[i] is answer.status is Status.OPTIMAL
        assert alone.cost(stack.f[i]) == pytest.approx(answer.objective, rel=2e-8)
        assert stack.torques[i] == pytest.approx(alone.torques(stack.f[i]), abs=1e-12)
        assert stack.residuals[i].max() <= 1e-8
    good = [i for i in range(count) if i != 7]
    assert all(stack.status[i] is Status.OPTIMAL for i in good)
    assert np.abs(stack.f[good] @ problem.G.T - w[good]).max() <= 1e-8 * np.abs(w[good]).max()


def test_stack_rejects_invalid_arrays_and_unsupported_problems():
    problem = feasible_problem(2)
    bare = ForceProblem(problem.contacts, problem.w)
    pyramid = ForceProblem(problem.contacts, problem.w, problem.actuation, Cone("pyramid"))
    level = ForceProblem(problem.contacts, problem.w, problem.actuation, objective=Objective("max_normal"))
    for asked, rows, field in (
        (problem, {}, "w"),
        (problem, {"w": np.zeros((3, 5))}, "w"),
        (problem, {"w": np.zeros((3, 6)), "tau_u": np.zeros((2, 12))}, "w, tau_u"),
        (problem, {"w": np.zeros((0, 6))}, "w"),
        (problem, {"J": np.zeros((3, 12, 11))}, "J"),
        (bare, {"tau_u": np.zeros((3, 0))}, "hand"),
        (pyramid, {"w": np.zeros((3, 6))}, "cone.type"),
    ):
        with pytest.raises(InvalidInput) as caught:
            solve_stack(asked, **rows)
        assert caught.value.field == field
    with pytest.raises(BackendError, match="max_normal"):
        solve_stack(level, w=np.zeros((3, 6)))
