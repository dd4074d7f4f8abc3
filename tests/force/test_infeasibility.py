"""Explanations of infeasibility: factors and nearest wrench are sharp, and the text names the active limits."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from support.random_problems import random_problem

from graspforce import Actuation, Cone, Contact, ContactSet, ForceProblem, Objective, Status, solve
from graspforce.force.backends import clarabel
from graspforce.force.infeasibility import add_remedies


def pair(mu=0.25, **changes) -> list[Contact]:
    """Return two opposed contacts 10 cm apart on the y axis."""
    return [Contact([0, y, 0], [0, -np.sign(y), 0], mu, **changes) for y in (-0.05, 0.05)]


def nose_cone(n: int, mu: float) -> ForceProblem:
    """Return case E1 of Lobo et al. (1998): n contacts on a paraboloid under a unit load."""
    contacts = []
    for angle in 2 * np.pi * np.arange(1, n + 1) / n:
        x, y = 0.3 + np.cos(angle), np.sin(angle)
        contacts.append(Contact([x, y, x * x + y * y], [-2 * x, -2 * y, 1], mu))
    return ForceProblem(contacts, [0, 0, 1, 0, 0, 0])


@pytest.mark.parametrize(("n", "threshold"), [(5, 0.2155976), (6, 0.0933567)])
def test_friction_factor_equals_the_published_threshold(n, threshold):
    found = solve(nose_cone(n, 0.05)).infeasibility
    # The threshold is given to seven digits, the factor to 1e-6.
    assert 0.05 * found.friction_factor == pytest.approx(threshold, rel=2e-6)
    assert found.torque_factor is None


def test_nearest_wrench_and_friction_factor_of_a_pair():
    """At most 2 μ N = 5 N can be lifted and 8 N are required: the friction factor is 8/5."""
    answer = solve(ForceProblem(pair(max_normal=10.0), [0, 0, 8.0, 0, 0, 0]))
    assert answer.status is Status.INFEASIBLE
    assert answer.infeasibility.nearest_wrench == pytest.approx([0, 0, 5, 0, 0, 0], abs=1e-6)
    assert answer.infeasibility.friction_factor == pytest.approx(8 / 5, rel=2e-6)
    assert answer.infeasibility.contacts == (0, 1)
    assert "8 is required and at most 5 can be supplied" in answer.infeasibility.explanation
    assert "force along (0, 0, 1)" in answer.infeasibility.explanation


def test_explanation_stops_at_its_deadline_and_keeps_the_proof(monkeypatch):
    """Each program takes a second of a simulated clock: the first factors are computed, the last one is not."""
    clock = [0.0]

    def slow(program, time_limit=None):
        clock[0] += 1.0
        return clarabel.ClarabelBackend().solve_program(program)

    problem = ForceProblem(pair(max_normal=10.0), [0, 0, 8.0, 0, 0, 0])
    infeasibility = solve(problem, explain=False).infeasibility
    monkeypatch.setattr("graspforce.force.infeasibility.time", SimpleNamespace(perf_counter=lambda: clock[0]))
    in_part = add_remedies(problem, infeasibility, slow, deadline=5.5)
    assert clock[0] == 6.0
    assert in_part.nearest_wrench == pytest.approx([0, 0, 5, 0, 0, 0], abs=1e-6)
    assert in_part.friction_factor is None
    assert in_part.verified
    assert add_remedies(problem, infeasibility, slow).friction_factor == pytest.approx(8 / 5, rel=2e-6)
    nothing = solve(problem, explain_seconds=0.0)
    assert nothing.certificate.verified
    assert nothing.infeasibility.nearest_wrench is None
    assert solve(problem, explain_seconds=100.0).infeasibility.friction_factor == pytest.approx(8 / 5, rel=2e-6)


def test_torque_factor_of_a_pair():
    """One joint per finger with a lever arm of 5 cm: 8 N require f_n = 16 N and 0.8 N·m; the limit is 0.5 N·m."""
    J = np.zeros((6, 2))
    J[2, 0] = J[5, 1] = 0.05
    actuation = Actuation(J, upper=[0.5, 0.5], lower=[-0.5, -0.5])
    answer = solve(ForceProblem(pair(), [0, 0, 8.0, 0, 0, 0], actuation))
    assert answer.status is Status.INFEASIBLE
    assert answer.infeasibility.torque_factor == pytest.approx(0.8 / 0.5, rel=1e-6)
    assert answer.infeasibility.friction_factor == pytest.approx(0.8 / 0.5, rel=2e-6)
    assert answer.infeasibility.joints == (0, 1)
    assert "torque limits of joints 0 (upper), 1 (upper)" in answer.infeasibility.explanation


def test_equal_torque_limits_have_a_torque_factor():
    """Both torques are fixed at 0.5 N·m: 10 N on each side lift 5 N, and 8 N require the factor 1.6."""
    J = np.zeros((6, 2))
    J[2, 0] = J[5, 1] = 0.05
    actuation = Actuation(J, upper=[0.5, 0.5], lower=[0.5, 0.5])
    answer = solve(ForceProblem(pair(), [0, 0, 8.0, 0, 0, 0], actuation))
    assert answer.infeasibility.torque_factor == pytest.approx(1.6, rel=1e-6)


def test_contradictory_limits_are_infeasible_without_load():
    """One joint carries two contacts whose smallest normal forces exceed its torque limit."""
    J = np.zeros((6, 1))
    J[2, 0] = J[5, 0] = 0.05
    actuation = Actuation(J, lower=[-0.1], upper=[0.1])
    answer = solve(ForceProblem(pair(min_normal=3.0), np.zeros(6), actuation))
    assert answer.status is Status.INFEASIBLE
    assert answer.infeasibility.nearest_wrench is None
    assert answer.infeasibility.explanation.startswith("For every wrench")


def test_factors_are_none_if_no_factor_helps():
    """A moment about the line of two point contacts."""
    answer = solve(ForceProblem(pair(), [0, 0, 0, 0, 0.1, 0]))
    assert answer.infeasibility.friction_factor is None
    assert answer.infeasibility.torque_factor is None
    assert answer.infeasibility.nearest_wrench == pytest.approx(np.zeros(6), abs=1e-7)


def test_solve_without_explanation_omits_the_factors():
    answer = solve(ForceProblem(pair(max_normal=10.0), [0, 0, 8.0, 0, 0, 0]), explain=False)
    found = answer.infeasibility
    assert found.verified
    assert (found.friction_factor, found.torque_factor, found.nearest_wrench) == (None, None, None)


def scaled(problem: ForceProblem, friction: float = 1.0, torque: float = 1.0) -> ForceProblem:
    c, actuation = problem.contacts, problem.actuation
    contacts = ContactSet(c.p_OC, c.R_OC, c.models, c.mu * friction, c.gamma * friction, c.min_normal, c.max_normal)
    if actuation is not None:
        actuation = Actuation(
            actuation.J, actuation.tau_u, actuation.lower * torque, actuation.upper * torque, actuation.weight
        )
    return ForceProblem(contacts, problem.w, actuation, problem.cone, Objective("force"))


def test_each_factor_is_sufficient_and_the_smallest():
    """On random overloaded grasps, slightly above and below each factor, and around the nearest wrench."""
    rng, seen = np.random.default_rng(21), {"friction": 0, "torque": 0, "wrench": 0}
    for _ in range(40):
        easy = random_problem(rng, overload_probability=0.0)
        problem = easy.replace(w=easy.w * rng.uniform(2.0, 30.0))
        found = solve(problem).infeasibility
        if found is None:
            continue
        if found.friction_factor is not None:
            seen["friction"] += 1
            assert solve(scaled(problem, friction=found.friction_factor * (1 + 1e-5))).found
            assert not solve(scaled(problem, friction=found.friction_factor * (1 - 1e-4)), explain=False).found
        if found.torque_factor is not None:
            seen["torque"] += 1
            assert solve(scaled(problem, torque=found.torque_factor * (1 + 1e-5))).found
            assert not solve(scaled(problem, torque=found.torque_factor * (1 - 1e-4)), explain=False).found
        if found.nearest_wrench is not None:
            seen["wrench"] += 1
            near, missing = found.nearest_wrench, problem.w - found.nearest_wrench
            assert solve(problem.replace(w=near + 1e-4 * (easy.w - near))).found
            assert not solve(problem.replace(w=near + 1e-4 * missing), explain=False).found
    assert min(seen.values()) >= 5


def test_infeasibility_proof_uses_the_edges_of_the_pyramid():
    """An inner pyramid of four facets across the load supplies cos 45° of the exact cone's force."""
    contacts = [Contact([0, y, 0], [0, -np.sign(y), 0], 0.25, tangent=[0, 0, 1], max_normal=10.0) for y in (-0.05, 0.05)]
    load = 5.0 * np.cos(np.pi / 4)
    cone = Cone("pyramid", 4, "inner")
    assert solve(ForceProblem(contacts, [0, 0, load * (1 - 1e-6), 0, 0, 0], cone=cone)).found
    answer = solve(ForceProblem(contacts, [0, 0, load * (1 + 1e-6), 0, 0, 0], cone=cone))
    assert answer.status is Status.INFEASIBLE
    assert solve(ForceProblem(contacts, [0, 0, load * (1 + 1e-6), 0, 0, 0])).found
