"""Sensitivities: central differences for every block, adjoint equals forward, closed forms, and degenerate optima."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.random_problems import inner_forces, random_actuation, random_contacts

from graspforce import Actuation, Cone, Contact, ContactSet, ForceProblem, InvalidInput, Objective, sensitivities, solve
from graspforce.analysis.optimality import find_optimum
from graspforce.contact.matrices import grasp_matrix
from graspforce.core.errors import UnsupportedProblem

PROBLEMS = 12  # of each objective


def random_case(seed: int, kind: str) -> ForceProblem:
    """Return a feasible problem with exact cones and a unique optimum: a hand, or the cost ½‖f‖²."""
    rng = np.random.default_rng([seed, len(kind)])
    contacts = ContactSet.stack(random_contacts(rng, int(rng.integers(3, 6))))
    f = inner_forces(rng, contacts, share=0.9)
    actuation = None if kind == "object" else random_actuation(rng, contacts, f)
    objective = Objective("torque", force_weight=1e-4) if kind == "torque" else Objective("force", moment_length=0.02)
    return ForceProblem(contacts, grasp_matrix(contacts) @ f, actuation, objective=objective)


def changed(problem: ForceProblem, name: str, change: np.ndarray) -> ForceProblem:
    """Return the problem with one block of data changed."""
    contacts, a = problem.contacts, problem.actuation
    if name == "w":
        return problem.replace(w=problem.w + change)
    if name == "mu":
        return problem.replace(mu=contacts.mu + change)
    if name == "p":
        return problem.replace(p=contacts.p_OC + change)
    if name == "rotation":
        return problem.replace(R=Rotation.from_rotvec(change).as_matrix() @ contacts.R_OC)
    if name == "tau_u":
        return problem.replace(tau_u=a.tau_u + change)
    if name == "J":
        return problem.replace(J=a.J + change)
    lower, upper = a.lower + change * (name == "torque_lower"), a.upper + change * (name == "torque_upper")
    limits = ([x if np.isfinite(x) else None for x in side] for side in (lower.tolist(), upper.tolist()))
    other = Actuation(a.J, a.tau_u, *limits, weight=a.weight)
    return ForceProblem(contacts, problem.w, other, problem.cone, problem.objective)


def block_step(problem: ForceProblem, name: str, rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Return a random change of a block of data, small against its size."""
    size = {
        "w": 1.0,
        "mu": 0.3,
        "p": 0.03,
        "rotation": 0.3,
        "tau_u": 0.05,
        "torque_lower": 0.1,
        "torque_upper": 0.1,
        "J": 0.05,
    }[name]
    change = size * rng.normal(size=shape)
    if name == "mu":
        change[problem.contacts.mu == 0.0] = 0.0
    if name == "J":  # only within the fingers
        change *= problem.actuation.J != 0.0
    return change


def central_difference(problem: ForceProblem, name: str, change: np.ndarray, step: float, active) -> np.ndarray | None:
    """Return the difference quotient of (f, tau, objective), from optima refined with the same active limits."""
    ends = []
    for sign in (1.0, -1.0):
        solution = solve(changed(problem, name, sign * step * change), explain=False)
        if not solution.found:
            return None
        optimum = find_optimum(solution)
        if optimum.undecided or optimum.active != active:
            return None
        other = optimum.problem
        ends.append(np.concatenate([optimum.f, other.torques(optimum.f), [other.cost(optimum.f)]]))
    return (ends[0] - ends[1]) / (2.0 * step)


@pytest.mark.parametrize("kind", ["torque", "force", "object"])
def test_forward_products_equal_central_differences_for_every_block(kind):
    compared = dict.fromkeys(("w", "mu", "p", "rotation"), 0)
    for seed in range(PROBLEMS // 4):
        problem = random_case(seed, kind)
        solution = solve(problem, explain=False)
        answer = sensitivities(solution)
        if answer.degenerate:
            continue
        rng = np.random.default_rng(seed)
        for name in answer.data:
            change = block_step(problem, name, rng, answer.objective[name].shape)
            result = answer.forward({name: change})
            exact = np.concatenate([result.f, result.tau, [result.objective]])
            errors = []
            for step in (1e-5, 1e-6):  # a larger step has truncation, a smaller one rounding
                expected = central_difference(problem, name, change, step, answer.optimum.active)
                if expected is not None:
                    size = np.abs(expected).max() + 1e-3 * np.abs(solution.f).max()
                    errors.append(np.abs(exact - expected).max() / size)
            if errors:
                assert min(errors) < 1e-5, (name, seed)
                compared[name] = compared.get(name, 0) + 1
    assert min(compared.values()) >= 1, compared


@pytest.mark.parametrize("kind", ["torque", "force", "object"])
def test_adjoint_products_equal_forward_products(kind):
    """⟨x̄, D θ̇⟩ = ⟨Dᵀ x̄, θ̇⟩, and both equal the full matrices."""
    compared = 0
    for seed in range(PROBLEMS):
        solution = solve(random_case(seed, kind), explain=False)
        answer = sensitivities(solution) if solution.found else None
        if answer is None or answer.degenerate:
            continue
        rng = np.random.default_rng(seed)
        n = len(solution.torques)
        f_bar, tau_bar, objective_bar = rng.normal(size=len(solution.f)), rng.normal(size=n), float(rng.normal())
        gradient = answer.adjoint(f_bar, tau_bar if n else None, objective_bar)
        for name in answer.data:
            change = rng.normal(size=answer.objective[name].shape)
            forward = answer.forward({name: change})
            one = f_bar @ forward.f + tau_bar @ forward.tau + objective_bar * forward.objective
            size = (
                np.abs(f_bar) @ np.abs(forward.f)
                + np.abs(tau_bar) @ np.abs(forward.tau)
                + abs(objective_bar * forward.objective)
            )
            size += float(np.sum(np.abs(gradient[name] * change)))
            assert abs(one - float(np.sum(gradient[name] * change))) <= 1e-12 * size
            matrix = np.tensordot(answer.f[name], change, axes=change.ndim)
            np.testing.assert_allclose(matrix, forward.f, atol=1e-12 * max(np.abs(forward.f).max(), 1e-300))
        compared += 1
    assert compared >= PROBLEMS // 2


def ring(n: int, mu: float, weight: float) -> ForceProblem:
    """Return case E3: n symmetric horizontal contacts that hold a weight, N."""
    angles = 2 * np.pi * np.arange(n) / n
    contacts = [Contact((0.05 * np.cos(a), 0.05 * np.sin(a), 0), (-np.cos(a), -np.sin(a), 0), mu) for a in angles]
    return ForceProblem(contacts, (0, 0, weight, 0, 0, 0))


def test_the_objective_of_symmetric_contacts_has_its_closed_form():
    """½‖f‖² = W²(1 + 1/μ²)/(2n): its derivatives are W(1 + 1/μ²)/n and −W²/(n μ³), and 1/n of it for each contact."""
    n, mu, weight = 3, 0.5, 2.0
    answer = sensitivities(solve(ring(n, mu, weight)))
    assert not answer.degenerate
    assert answer.objective["w"] == pytest.approx([0, 0, weight * (1 + 1 / mu**2) / n, 0, 0, 0], abs=1e-9)
    assert answer.objective["mu"] == pytest.approx([-(weight**2) / (n * mu**3) / n] * n, rel=1e-9)


def test_optima_without_a_derivative_are_flagged():
    """An unloaded grasp is at the apexes; two opposed contacts have dependent equations; an idle motor is at its limit."""
    unloaded = sensitivities(solve(ring(3, 0.5, 0.0)))
    assert unloaded.degenerate
    pair = [Contact((0, y, 0), (0, -y, 0), 0.5, min_normal=1.0) for y in (0.05, -0.05)]
    dependent = sensitivities(solve(ForceProblem(pair, (0, 0, 0.5, 0, 0, 0))))
    assert dependent.degenerate
    for call in (lambda: dependent.f, lambda: dependent.forward({"w": np.ones(6)}), dependent.adjoint):
        with pytest.raises(InvalidInput, match="derivatives do not exist"):
            call()


def test_a_limit_that_is_reached_without_a_multiplier_is_flagged():
    """A frictionless table below carries a third of a push upwards: its limit is set to just that force."""
    contacts = [Contact((0, y, 0), (0, -y, 0), 2.0, min_normal=1.0) for y in (0.05, -0.05)]
    table = Contact((0, 0, -0.05), (0, 0, 1), model="frictionless")
    free = solve(ForceProblem([*contacts, table], (0, 0, 1.0, 0, 0, 0)))
    assert float(free.forces[2][0]) == pytest.approx(1.0 / 3.0, rel=1e-6)
    for limit, is_flagged in ((1.0 / 3.0, True), (0.5, False), (0.2, False)):
        limited = Contact((0, 0, -0.05), (0, 0, 1), model="frictionless", max_normal=limit)
        reasons = sensitivities(solve(ForceProblem([*contacts, limited], (0, 0, 1.0, 0, 0, 0)))).degenerate
        assert any("upper normal limit 2" in reason for reason in reasons) == is_flagged


def test_refuses_pyramids_other_objectives_and_unsolved_problems():
    problem = ring(3, 0.5, 2.0)
    pyramids = ForceProblem(problem.contacts, problem.w, cone=Cone("pyramid", 8))
    with pytest.raises(UnsupportedProblem, match="exact cones"):
        sensitivities(solve(pyramids))
    largest = ForceProblem(problem.contacts, problem.w, objective=Objective("max_normal"))
    with pytest.raises(UnsupportedProblem, match="max_normal"):
        sensitivities(solve(largest))
    pulled = ForceProblem([Contact((0, 0, 0), (0, 0, 1), 0.5)], (0, 0, -1.0, 0, 0, 0))
    with pytest.raises(InvalidInput, match="certified forces"):
        sensitivities(solve(pulled, explain=False))
    with pytest.raises(InvalidInput, match="changes"):
        sensitivities(solve(problem)).forward({"mass": 1.0})
