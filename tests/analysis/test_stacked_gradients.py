"""Gradients of stacked problems, computed in C, equal the adjoint products of `sensitivities`; degenerate optima have none."""

from __future__ import annotations

import numpy as np
import pytest
from support.random_problems import inner_forces, random_actuation, random_contacts

import graspforce as gf
from graspforce.contact.matrices import grasp_matrix
from graspforce.core.errors import UnknownName, UnsupportedProblem
from graspforce.force.problem_data import change_problem

BLOCKS = ("w", "mu", "p", "rotation", "tau_u", "torque_lower", "torque_upper", "J")
OBJECTIVES = {
    "torque": gf.Objective("torque", force_weight=1e-4),
    "force": gf.Objective("force", moment_length=0.02),
    "object": gf.Objective("force"),
    "sum_normal": gf.Objective("sum_normal"),
}


def random_case(seed: int, kind: str) -> gf.ForceProblem:
    """Return a feasible problem of frictionless, point and soft contacts."""
    rng = np.random.default_rng([seed, 71])
    contacts = gf.ContactSet.stack(random_contacts(rng, int(rng.integers(3, 6))))
    f = inner_forces(rng, contacts, share=0.9)
    actuation = None if kind == "object" else random_actuation(rng, contacts, f)
    return gf.ForceProblem(contacts, grasp_matrix(contacts) @ f, actuation, objective=OBJECTIVES[kind])


def random_seeds(problem: gf.ForceProblem, rng: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    """Return random derivatives of a function of each optimum."""
    n = 0 if problem.actuation is None else len(problem.actuation.tau_u)
    return {
        "f": rng.normal(size=(count, problem.size)),
        "tau": rng.normal(size=(count, n)),
        "objective": rng.normal(size=count),
    }


def assert_gradients_equal(
    gradients: gf.StackedGradients, i: int, problem: gf.ForceProblem, seeds: dict[str, np.ndarray]
) -> bool:
    """Compare gradients of problem i with the adjoint product of its solution. Return whether they exist.

    Both refine the optimum until the conditions hold to rounding. What remains is rounding times the condition of the
    Jacobian, which is below 1e5 here.
    """
    answer = gf.sensitivities(gf.solve(problem, explain=False))
    assert gradients.degenerate[i] == (answer.degenerate[0] if answer.degenerate else "")
    if answer.degenerate:
        assert all(np.isnan(getattr(gradients, name)[i]).all() for name in BLOCKS)
        return False
    tau = seeds["tau"][i] if problem.actuation is not None else None
    for name, exact in answer.adjoint(seeds["f"][i], tau, float(seeds["objective"][i])).items():
        np.testing.assert_allclose(getattr(gradients, name)[i], exact, rtol=0.0, atol=1e-10 * np.abs(exact).max(), err_msg=name)
    return True


@pytest.mark.parametrize("kind", OBJECTIVES)
def test_gradients_equal_adjoint_products_of_every_block(kind):
    count, regular = 3, 0
    for seed in range(6):
        problem, rng = random_case(seed, kind), np.random.default_rng(seed)
        contacts, a = problem.contacts, problem.actuation
        data = {
            "w": problem.w * (1.0 + 0.001 * rng.random((count, 6))),
            "mu": contacts.mu * (1.0 + 0.01 * rng.random((count, len(contacts)))),
            "p": contacts.p_OC + 1e-5 * rng.normal(size=(count, len(contacts), 3)),
        }
        if a is not None:
            data |= {"tau_u": a.tau_u + 1e-4 * rng.normal(size=(count, len(a.tau_u)))}
            data |= {"J": a.J * (1.0 + 0.001 * rng.normal(size=(count, *a.J.shape)))}
        seeds = random_seeds(problem, rng, count)
        stack = gf.solve_stack(problem, adjoint=seeds, **data)
        for i in np.flatnonzero(np.isfinite(stack.objective)):
            own = change_problem(problem, {name: rows[i] for name, rows in data.items()})
            regular += assert_gradients_equal(stack.gradients, int(i), own, seeds)
    assert regular >= 3 * count


def ring(weight: float) -> gf.ForceProblem:
    """Return three symmetric horizontal contacts that hold a weight, N."""
    angles = 2 * np.pi * np.arange(3) / 3
    contacts = [gf.Contact((0.05 * np.cos(a), 0.05 * np.sin(a), 0), (-np.cos(a), -np.sin(a), 0), 0.5) for a in angles]
    return gf.ForceProblem(contacts, (0, 0, weight, 0, 0, 0))


def test_a_degenerate_or_infeasible_problem_does_not_affect_the_others():
    """½‖f‖² = W²(1 + 1/μ²)/(2n) for the weights 1 and 2; a grasp without load is at the apexes of its cones."""
    capped = [gf.Contact(p, R[:, 2], 0.5, max_normal=5.0) for p, R in zip(*ring_places(), strict=True)]
    weights = np.array([1.0, 0.0, 100.0, 2.0])
    loads = weights[:, None] * np.eye(6)[2]
    stack = gf.solve_stack(gf.ForceProblem(capped, loads[0]), w=loads, adjoint={"objective": 1.0})
    gradients = stack.gradients
    assert [bool(reason) for reason in gradients.degenerate] == [False, True, True, False]
    assert gradients.degenerate[1] == gf.sensitivities(gf.solve(ring(0.0))).degenerate[0]
    assert gradients.degenerate[2] == gf.Status.INFEASIBLE.sentence
    assert np.isnan(gradients.w[1:3]).all()
    slope = weights[[0, 3]] * (1 + 1 / 0.5**2) / 3
    np.testing.assert_allclose(gradients.w[[0, 3], 2], slope, rtol=1e-12)
    assert gradients.J.shape == (4, 9, 0)


def ring_places() -> tuple[np.ndarray, np.ndarray]:
    """Return positions and frames of the ring."""
    contacts = ring(1.0).contacts
    return contacts.p_OC, contacts.R_OC


def test_problems_that_the_kernel_does_not_certify_have_gradients_too():
    """J of the second problem links a contact to another finger's joint, which the stack's structure does not have."""
    problem = random_case(0, "torque")
    linked = problem.actuation.J.copy()
    linked[0, -1] = linked[-1, 0] = 0.002
    seeds = random_seeds(problem, np.random.default_rng(8), 2)
    J = np.stack([problem.actuation.J, linked])
    stack = gf.solve_stack(problem, J=J, adjoint=seeds)
    assert all(status is gf.Status.OPTIMAL for status in stack.status)
    assert all(assert_gradients_equal(stack.gradients, i, problem.replace(J=J[i]), seeds) for i in range(2))


def test_seeds_of_one_function_apply_to_all_problems_whatever_the_threads():
    problem, rng = random_case(1, "torque"), np.random.default_rng(9)
    w = problem.w * (1.0 + 0.001 * rng.random((300, 6)))  # two chunks
    one = {name: seed[0] for name, seed in random_seeds(problem, rng, 1).items()}
    every = {name: np.broadcast_to(seed, (300, *np.shape(seed))) for name, seed in one.items()}
    first = gf.solve_stack(problem, w=w, adjoint=one, threads=1).gradients
    second = gf.solve_stack(problem, w=w, adjoint=every, threads=3).gradients
    for name in BLOCKS:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert gf.solve_stack(problem, w=w[:2]).gradients is None


def test_refuses_unknown_seeds_wrong_shapes_and_objectives_without_gradients():
    problem = random_case(1, "torque")
    w = np.stack([problem.w] * 2)
    with pytest.raises(UnknownName, match="objective"):
        gf.solve_stack(problem, w=w, adjoint={"cost": 1.0})
    with pytest.raises(gf.InvalidInput, match=r"adjoint\.f"):
        gf.solve_stack(problem, w=w, adjoint={"f": np.zeros((3, problem.size))})
    margin = gf.ForceProblem(problem.contacts, problem.w, problem.actuation, objective=gf.Objective("margin"))
    with pytest.raises((UnsupportedProblem, gf.InvalidInput)):
        gf.solve_stack(margin, w=w, adjoint={"objective": 1.0})
