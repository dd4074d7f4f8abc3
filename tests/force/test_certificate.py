"""The certificate accepts optima and proofs of infeasibility, and rejects everything else."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.random_problems import random_problem

from graspforce import Actuation, Contact, ForceProblem, Multipliers, Objective, Status, solve
from graspforce.force.certificate import LOOSE_TOLERANCE, TIGHT_TOLERANCE, certify, certify_infeasibility
from graspforce.force.scale import scale


def three_fingers(weight=1.0, mu=0.5) -> ForceProblem:
    """Return case E3: three horizontal contacts at 120° on a ring of 5 cm carry a weight."""
    contacts = []
    for angle in 2 * np.pi * np.arange(3) / 3:
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        contacts.append(Contact(0.05 * out, -out, mu, tangent=[0, 0, 1]))
    return ForceProblem(contacts, [0, 0, weight, 0, 0, 0])


def by_hand(problem: ForceProblem) -> tuple[np.ndarray, Multipliers]:
    """Return the analytical optimum of E3: f_t = W/3 upwards, f_n = W/(3μ), and y from ∂cost/∂W = W(1 + 1/μ²)/3."""
    weight, mu = problem.w[2], problem.contacts.mu[0]
    f = np.tile([weight / 3, 0.0, weight / (3 * mu)], 3)
    nothing = np.zeros(3)
    y = np.array([0, 0, weight * (1 + 1 / mu**2) / 3, 0, 0, 0])
    return f, Multipliers(y, nothing, nothing, np.zeros(0), np.zeros(0), nothing)


def test_certificate_accepts_an_analytical_optimum():
    problem = three_fingers(weight=2.0, mu=0.4)
    certificate = certify(problem, *by_hand(problem))
    assert certificate.verified
    assert certificate.tolerance == TIGHT_TOLERANCE
    assert max(certificate.primal_residual, certificate.dual_residual, certificate.gap) < 1e-14


def test_gap_equals_the_excess_cost():
    """A normal force that is s too large on each of three fingers costs 3(f_n s + s²/2)."""
    problem, squeeze = three_fingers(), 0.01
    f, multipliers = by_hand(problem)
    tighter = f + np.tile([0.0, 0.0, squeeze], 3)
    certificate = certify(problem, tighter, multipliers)
    assert not certificate.verified
    lost = 3 * (f[2] * squeeze + squeeze**2 / 2)
    assert problem.cost(tighter) - problem.cost(f) == pytest.approx(lost, rel=1e-12)
    # The gap is an upper bound; the change of z with f adds at most as much again.
    assert lost <= certificate.gap * (1.0 + problem.cost(tighter)) <= 2 * lost + 1e-12


@pytest.mark.parametrize("seed", range(60))
def test_certificate_rejects_perturbed_forces_and_multipliers(seed):
    rng = np.random.default_rng([4, seed])
    problem = random_problem(rng, overload_probability=0.0)
    answer = solve(problem, explain=False)
    unit = scale(problem)
    assert certify(problem, answer.f, answer.multipliers).verified
    out_of_balance = answer.f + 1e-3 * unit.force * problem.G[0]
    assert certify(problem, out_of_balance, answer.multipliers).primal_residual > LOOSE_TOLERANCE
    pulling = answer.f.copy()
    pulling[problem.contacts.normal_rows[0]] = -1e-3 * unit.force
    assert certify(problem, pulling, answer.multipliers).primal_residual > LOOSE_TOLERANCE
    m = answer.multipliers
    wrong_side = dataclasses.replace(m, normal_lower=m.normal_lower - unit.cost / unit.force)
    assert not certify(problem, answer.f, wrong_side).verified
    dear = dataclasses.replace(m, y=m.y * 1.1)
    if np.abs(m.y @ problem.w) > 1e-2 * (unit.cost + abs(answer.objective)):
        assert not certify(problem, answer.f, dear).verified


@pytest.mark.parametrize("seed", range(30))
def test_gap_bounds_the_excess_cost_of_feasible_forces(seed):
    """All forces between the optima of two objectives are feasible, and cost more than the optimum."""
    problem = random_problem(np.random.default_rng([8, seed]), overload_probability=0.0)
    problem = ForceProblem(problem.contacts, problem.w, problem.actuation, problem.cone, Objective("force"))
    elsewhere = ForceProblem(problem.contacts, problem.w, problem.actuation, problem.cone, Objective("max_normal"))
    best, other = solve(problem, explain=False), solve(elsewhere, explain=False)
    for share in (0.01, 0.1, 1.0):
        f = (1 - share) * best.f + share * other.f
        certificate = certify(problem, f, best.multipliers)
        loss = (problem.cost(f) - best.objective) / (scale(problem).cost + problem.cost(f))
        assert certificate.primal_residual <= TIGHT_TOLERANCE
        assert -TIGHT_TOLERANCE <= loss <= certificate.gap + TIGHT_TOLERANCE
        assert certificate.verified == (max(certificate.gap, certificate.dual_residual) <= LOOSE_TOLERANCE)


def test_certificate_rejects_non_finite_input():
    problem = three_fingers()
    f, m = by_hand(problem)
    for bad in (np.nan, np.inf, 1e300):
        assert not certify(problem, np.full(9, bad), m).verified
        assert not certify(problem, f, dataclasses.replace(m, y=np.full(6, bad))).verified
        assert not certify_infeasibility(problem, dataclasses.replace(m, y=np.full(6, bad))).certificate.verified


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("distance", [1.0, 1e3, 1e6])
def test_rounding_of_a_distant_wrench_proves_no_infeasibility(seed, distance):
    """One finger far from O supplies the wrench of its own force; rounding of the moment is no contradiction."""
    rng = np.random.default_rng([13, seed])
    p = distance * rng.normal(size=3)
    contact = Contact(p, rng.normal(size=3), 0.5)
    force = contact.normal * rng.exponential()
    moment = np.nextafter(np.cross(p, force), np.inf)
    problem = ForceProblem([contact], np.append(force, moment))
    # yᵀG = 0 for y = (p × m, m): the finger's force has no moment about the finger
    m = 1e20 * (moment - np.cross(p, force))
    none = np.zeros(1)
    proof = Multipliers(np.append(np.cross(p, m), m), none, none, np.zeros(0), np.zeros(0), none)
    assert not certify_infeasibility(problem, proof).certificate.verified
    turned = ForceProblem([contact], np.append(force, moment + 1e-6 * distance * m / np.linalg.norm(m)))
    assert certify_infeasibility(turned, proof).certificate.verified


def test_infeasibility_proof_does_not_overflow():
    """The proof has two terms of 1e308, whose sum overflows: tau ≥ 1e308 on two joints without load."""
    actuation = Actuation(np.zeros((9, 2)), lower=[1e308, 1e308])
    problem = ForceProblem(three_fingers().contacts, np.zeros(6), actuation, objective=Objective("force"))
    nothing = np.zeros(3)
    both = Multipliers(np.zeros(6), nothing, nothing, np.ones(2), np.zeros(2), nothing)
    infeasibility_proof = certify_infeasibility(problem, both)
    assert infeasibility_proof.certificate.verified
    assert infeasibility_proof.certificate.gap == pytest.approx(2.0, rel=1e-12)


def test_overflowing_cost_proves_no_optimality():
    """A joint without load has a torque of 1e200 N·m, whose square would hide any excess cost of the other joint."""
    J = np.zeros((9, 2))
    J[[2, 5, 8], 0] = 0.05
    problem = ForceProblem(three_fingers().contacts, [0, 0, 1.0, 0, 0, 0], Actuation(J, tau_u=[0.0, 1e200]))
    nothing = np.zeros(3)
    still = Multipliers(np.zeros(6), nothing, nothing, np.zeros(2), np.zeros(2), nothing)
    f, _ = by_hand(three_fingers())
    assert not certify(problem, 10.0 * f - 9.0 * np.tile([1 / 3, 0.0, 0.0], 3), still).verified


@pytest.mark.parametrize("force", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("length", [1e-2, 1.0, 1e2])
def test_residuals_do_not_depend_on_units(force, length):
    rng = np.random.default_rng(12)
    f, m = by_hand(three_fingers())
    spoilt = f + rng.normal(size=9) * 1e-3

    def residuals(force, length):
        contacts = [
            Contact(c.position * length, c.normal, c.friction, tangent=c.tangent) for c in three_fingers().contacts.contacts
        ]
        problem = ForceProblem(contacts, [0, 0, force, 0, 0, 0])
        seen = certify(problem, spoilt * force, dataclasses.replace(m, y=m.y * force))
        return seen.primal_residual, seen.dual_residual, seen.gap

    assert residuals(force, length) == pytest.approx(residuals(1.0, 1.0), rel=1e-9)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), spread=st.sampled_from([0.0, 1e-9, 1e-3, 1.0]))
def test_proof_for_an_infeasible_load_does_not_refute_a_feasible_one(seed, spread):
    """The loads are just inside and just outside the limit of the grasp; the proof is perturbed."""
    rng = np.random.default_rng([9, seed])
    problem = random_problem(rng, overload_probability=0.0)
    held, beyond = problem.w, 1e4 * problem.w
    if solve(problem.replace(w=beyond), explain=False).found:
        return  # no limit bounds the loads of this grasp
    for _ in range(24):
        middle = (held + beyond) / 2
        held, beyond = (middle, beyond) if solve(problem.replace(w=middle), explain=False).found else (held, middle)
    refused = solve(problem.replace(w=beyond), explain=False)
    assert refused.status in (Status.INFEASIBLE, Status.FAILED)
    parts = (getattr(refused.multipliers, name.name) for name in dataclasses.fields(Multipliers))
    noisy = Multipliers(*(part * (1 + spread * rng.normal(size=len(part))) for part in parts))
    assert not certify_infeasibility(problem.replace(w=held), noisy).certificate.verified


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_no_multipliers_refute_a_feasible_problem(seed):
    rng = np.random.default_rng([10, seed])
    problem = random_problem(rng, overload_probability=0.0)
    count, n = len(problem.contacts), 0 if problem.actuation is None else len(problem.actuation.tau_u)
    anything = Multipliers(*(rng.normal(size=size) for size in (6, count, count, n, n, count)))
    assert not certify_infeasibility(problem, anything).certificate.verified


def test_certificate_accepts_an_analytical_infeasibility_proof():
    """Two opposed contacts lift at most 2 μ N: y = e_z, ν_upper = μ on each, and z follows."""
    contacts = [Contact([0, y, 0], [0, -np.sign(y), 0], 0.25, max_normal=10.0) for y in (-0.05, 0.05)]
    nothing = np.zeros(2)
    ray = Multipliers(np.array([0, 0, 3.0, 0, 0, 0]), nothing, nothing, np.zeros(0), np.zeros(0), nothing)
    beyond = ForceProblem(contacts, [0, 0, 5.0 * (1 + 1e-12), 0, 0, 0])
    within = ForceProblem(contacts, [0, 0, 5.0 * (1 - 1e-12), 0, 0, 0])
    infeasibility_proof = certify_infeasibility(beyond, ray)
    assert infeasibility_proof.certificate.verified
    assert infeasibility_proof.multipliers.normal_upper == pytest.approx(
        [0.25 * infeasibility_proof.multipliers.y[2]] * 2, rel=1e-12
    )
    assert not certify_infeasibility(within, ray).certificate.verified
