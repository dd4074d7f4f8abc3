"""Stacks of problems equal their problems one by one, for every block of data; their gradients are in tests/analysis."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.random_problems import feasible_problem

from graspforce import Cone, ForceProblem, InvalidInput, Objective, Status, solve, solve_stack
from graspforce.core.errors import BackendError
from graspforce.force.problem_data import change_problem


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
        (bare, {"tau_u": np.zeros((3, 0))}, "tau_u"),
        (pyramid, {"w": np.zeros((3, 6))}, "cone.type"),
    ):
        with pytest.raises(InvalidInput) as caught:
            solve_stack(asked, **rows)
        assert caught.value.field == field
    with pytest.raises(BackendError, match="max_normal"):
        solve_stack(level, w=np.zeros((3, 6)))


def test_every_block_of_data_can_be_stacked():
    problem, rng, count = feasible_problem(3, models=("point", "soft", "frictionless")), np.random.default_rng(52), 5
    contacts, a = problem.contacts, problem.actuation
    turn = Rotation.from_rotvec(0.01 * rng.normal(size=(count * 4, 3))).as_matrix().reshape(count, 4, 3, 3)
    blocks = {
        "mu": contacts.mu * (1 + 0.05 * rng.random((count, 4))),
        "p": contacts.p_OC + 1e-4 * rng.normal(size=(count, 4, 3)),
        "R": turn @ contacts.R_OC,
        "torque_lower": a.lower * (1 + 0.1 * rng.random((count, 12))),
        "torque_upper": np.where(rng.random((count, 12)) < 0.2, np.inf, a.upper),
    }
    for given in (*({name: value} for name, value in blocks.items()), blocks):
        stack = solve_stack(problem, **given)
        for i in range(count):
            alone = change_problem(problem, {name: rows[i] for name, rows in given.items()})
            answer = solve(alone)
            assert stack.status[i] is answer.status is Status.OPTIMAL
            assert stack.objective[i] == pytest.approx(alone.cost(stack.f[i]), rel=1e-12)
            assert stack.objective[i] == pytest.approx(answer.objective, rel=2e-8)


def test_values_of_stacked_data_are_checked():
    problem = feasible_problem(2)
    frames = np.stack([problem.contacts.R_OC, 1.001 * problem.contacts.R_OC])
    limits = np.stack([problem.actuation.lower, problem.actuation.upper + 1.0])
    for rows, field in (
        ({"mu": [[0.5, 0.5, -0.1, 0.5]]}, "mu"),
        ({"R": frames}, "R[1][0]"),
        ({"torque_lower": limits}, "torque_lower[1][0]"),
        ({"torque_upper": np.full((1, 12), -np.inf)}, "torque_upper"),
        ({"p": np.full((1, 4, 3), np.nan)}, "p"),
    ):
        with pytest.raises(InvalidInput) as caught:
            solve_stack(problem, **rows)
        assert caught.value.field.startswith(field), field
