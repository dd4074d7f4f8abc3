"""Solutions of the kernel: optimality by their own multipliers, by Clarabel, and by closed forms."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("graspforce.force.backends._structured", reason="the kernel was not built: no C compiler at installation")

from support.kernel_cases import CaseOptions, KernelCase, case_without_hand, in_units, random_case
from support.kernel_checks import (
    clarabel_optimum,
    dual_violation,
    lower_bound,
    objective,
    proof_margin,
    smallest_multiplier,
    stationarity,
    violation,
)
from support.kernel_runs import FAILED, INFEASIBLE, OPTIMAL, bind_kernel, solve

KINDS = {
    "point": CaseOptions(),
    "soft": CaseOptions(models=(4,)),
    "mixed": CaseOptions(models=(1, 3, 4), joints=(2, 3, 4, 5)),
    "several contacts per finger": CaseOptions(contacts=(1, 2, 3), joints=(3, 4)),
    "fingers without joints": CaseOptions(contacts=(1, 2, 3), joints=(0, 1, 3), models=(1, 3, 4), force_weight=1e-3),
    "missing limits": CaseOptions(unlimited=0.5),
    "fewer joints than components": CaseOptions(joints=(1, 2)),
    "no hand": CaseOptions(joints=(0,), force_weight=1.0),
    "zero friction": CaseOptions(frictionless=0.3, models=(3, 4)),
    "fixed normal force": CaseOptions(pinned=0.3),
    "fixed torque": CaseOptions(clamped=0.4),
    "fixed normal force and torque": CaseOptions(pinned=0.3, clamped=0.5, contacts=(1, 2), models=(1, 3, 4)),
    "pyramids of 4": CaseOptions(facets=4),
    "pyramids of 8": CaseOptions(facets=8),
}


def cases(kind: str, count: int, seed: int) -> list[KernelCase]:
    rng = np.random.default_rng(seed)
    return [random_case(rng, int(rng.integers(3, 7)), KINDS[kind]) for _ in range(count)]


@pytest.mark.parametrize("kind", KINDS)
def test_solution_has_the_objective_of_clarabel(kind: str) -> None:
    """The objective agrees to 1e-8, and no constraint is violated by more than 1e-8 of the force unit."""
    for case in cases(kind, 20, seed=11):
        answer = solve(case)
        minimum = clarabel_optimum(case)
        assert answer.status == OPTIMAL
        assert violation(case, answer.f) <= 1e-8
        assert objective(case, answer.f) == pytest.approx(minimum, rel=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_multipliers_prove_the_optimum(kind: str) -> None:
    """Stationarity holds to rounding, signs and dual cones are right, and the lower bound equals the cost."""
    for case in cases(kind, 10, seed=12):
        answer = solve(case)
        cost = objective(case, answer.f)
        price = np.abs(answer.y[:3]).max() + np.abs(answer.z).max()  # cost per N
        assert np.abs(stationarity(case, answer)).max() <= 1e-12 * (price + cost / case.force)
        assert smallest_multiplier(answer) >= 0.0
        assert dual_violation(case, answer) * case.force <= 1e-9 * cost
        assert lower_bound(case, answer) == pytest.approx(cost, rel=1e-8)


def test_nose_cone_has_the_published_optimum() -> None:
    """Lobo, Vandenberghe, Boyd and Lebret (1998), five contacts: the minimum of Σ‖f‖² is 0.65888534."""
    angle = 2 * np.pi * np.arange(1, 6) / 5
    x, y = 0.3 + np.cos(angle), np.sin(angle)
    normals = np.column_stack([-2 * x, -2 * y, np.ones(5)])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    answer = solve(case_without_hand(np.column_stack([x, y, x**2 + y**2]), normals, 0.3, [0, 0, 1, 0, 0, 0]))
    assert answer.status == OPTIMAL
    assert answer.f @ answer.f == pytest.approx(0.65888534, abs=5e-9)


@pytest.mark.parametrize("limit", [np.inf, 100.0, 50.0])
def test_two_opposed_contacts_push_with_load_over_twice_the_friction(limit: float) -> None:
    """Load 10 N, μ = 0.1: f_n = 50 N and f_t = 5 N each. One equality is redundant, and the limit may be active."""
    case = case_without_hand([[0, -2, 0], [0, 2, 0]], [[0, 1, 0], [0, -1, 0]], 0.1, [0, 0, 10, 0, 0, 0], limit=limit)
    assert np.linalg.matrix_rank(case.G) == 5
    answer = solve(case)
    assert answer.status == OPTIMAL
    np.testing.assert_allclose(answer.f[[2, 5]], 50.0, rtol=1e-8)
    assert answer.f @ answer.f == pytest.approx(2 * 2525.0, rel=1e-8)


@pytest.mark.parametrize("contacts", [3, 4, 7])
def test_horizontal_ring_has_its_closed_form(contacts: int) -> None:
    """N contacts on a circle carry the weight W: ½‖f‖² = W²(1 + 1/μ²)/(2N)."""
    angle, mu, W = 2 * np.pi * np.arange(contacts) / contacts, 0.5, 2.0
    out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(contacts)])
    case = case_without_hand(0.05 * out, -out, mu, [0, 0, W, 0, 0, 0])
    assert objective(case, solve(case).f) == pytest.approx(W**2 * (1 + mu**-2) / (2 * contacts), rel=1e-8)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_single_contact_supplies_the_wrench(share: float) -> None:
    """The feasible set is one point, up to the boundary of the friction cone."""
    case = case_without_hand([[0, 0, 0]], [[0, 0, 1]], 0.5, [0.5 * share, 0, 1, 0, 0, 0])
    answer = solve(case)
    assert answer.status == OPTIMAL
    np.testing.assert_allclose(case.G[:3] @ answer.f, case.w[:3], atol=1e-8)


def test_coincident_contacts_share_the_load_equally() -> None:
    """Four contacts at one point oppose a single contact: each carries a quarter of its force."""
    normals = np.array([[-1, 0, 0]] * 4 + [[1, 0, 0]])
    case = case_without_hand(-0.03 * normals, normals, 0.5, [0, 0, 1, 0, 0, 0])
    answer = solve(case)
    assert answer.status == OPTIMAL
    np.testing.assert_allclose(answer.f.reshape(5, 3)[:4, 2], answer.f.reshape(5, 3)[4, 2] / 4, rtol=1e-6)
    assert objective(case, answer.f) == pytest.approx(clarabel_optimum(case), rel=1e-8)


def test_zero_wrench_needs_only_forces_that_relieve_the_motors() -> None:
    """Without bias torques the forces are zero; with them the objective agrees with Clarabel."""
    rng = np.random.default_rng(3)
    for _ in range(30):
        drawn = random_case(rng, 4)
        idle = replace(drawn, w=np.zeros(6), min_normal=np.zeros(4), tau_u=0 * drawn.tau_u)
        answer = solve(idle)
        assert answer.status == OPTIMAL
        # The cost is right to 1e-12 of its unit, so forces are right to 1e-6 of theirs, some newtons.
        assert np.abs(answer.f).max() <= 2e-5
        relieved = replace(drawn, w=np.zeros(6), min_normal=np.zeros(4))
        answer = solve(relieved)
        if answer.status == OPTIMAL:
            assert objective(relieved, answer.f) == pytest.approx(clarabel_optimum(relieved), rel=1e-8)
        else:
            assert answer.status == INFEASIBLE
            assert proof_margin(relieved, answer) > 0


@pytest.mark.parametrize("kind", ["point", "mixed", "missing limits"])
def test_linear_cost_has_the_objective_of_clarabel(kind: str) -> None:
    for case in cases(kind, 8, seed=14):
        cost = np.zeros(case.k)
        cost[case.normals] = 1.0
        linear = replace(case, cost=cost, weight=0 * case.weight)
        answer = solve(linear)
        assert answer.status == OPTIMAL
        assert objective(linear, answer.f) == pytest.approx(clarabel_optimum(linear), rel=1e-8)


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3])
def test_accuracy_does_not_depend_on_unequal_friction(scale: float) -> None:
    """Every second contact has its friction coefficient multiplied by `scale`."""
    rng = np.random.default_rng(15)
    for _ in range(8):
        case = random_case(rng, 5)
        mu = case.mu * np.where(np.arange(5) % 2, scale, 1.0)
        f = np.zeros(case.k)
        f[case.normals] = rng.uniform(1.0, 3.0, size=5)
        f[case.normals - 1] = 0.5 * np.minimum(mu, 1.0) * f[case.normals]
        limit = np.abs(case.tau_u + case.J.T @ f) + 0.05
        case = replace(case, mu=mu, w=case.G @ f, lower=-limit, upper=limit)
        answer = solve(case)
        assert answer.status == OPTIMAL
        assert violation(case, answer.f) <= 1e-8
        assert objective(case, answer.f) == pytest.approx(clarabel_optimum(case), rel=1e-8)


@pytest.mark.parametrize(("force", "length"), list(itertools.product([1e-4, 1.0, 1e4], [1e-2, 1.0, 1e2])))
def test_solution_does_not_depend_on_units(force: float, length: float) -> None:
    """Over eight decades of force and four of length, iterations are the same and forces equal to rounding."""
    for kind in ("point", "mixed"):
        for case in cases(kind, 4, seed=31):
            other = in_units(case, force, length)
            first, second = solve(case), solve(other)
            assert first.status == second.status == OPTIMAL
            assert abs(first.iterations - second.iterations) <= 1
            unit = force * np.where(case.columns % 4 == 3, length, 1.0)
            assert objective(case, second.f * unit) == pytest.approx(objective(case, first.f), rel=1e-8)
            assert violation(case, second.f * unit) <= 1e-8


def test_solution_does_not_depend_on_the_order_of_fingers() -> None:
    options = CaseOptions(models=(1, 3, 4), contacts=(1, 2), joints=(2, 3))
    case = random_case(np.random.default_rng(52), 6, options)
    reversed_order = replace(case, contact_block=(5 - case.contact_block), joint_block=(5 - case.joint_block))
    assert objective(case, solve(reversed_order).f) == pytest.approx(objective(case, solve(case).f), rel=1e-8)


def test_solution_does_not_depend_on_the_partition_into_fingers() -> None:
    for case in cases("mixed", 5, seed=53):
        one_block = replace(case, contact_block=0 * case.contact_block, joint_block=0 * case.joint_block)
        assert objective(case, solve(one_block).f) == pytest.approx(objective(case, solve(case).f), rel=1e-8)


def test_iterations_are_bounded() -> None:
    case = random_case(np.random.default_rng(43), 4)
    answer = solve(case, max_iterations=1)
    assert answer.iterations == 1
    assert answer.status == FAILED


def test_looser_tolerance_needs_fewer_iterations() -> None:
    case = random_case(np.random.default_rng(44), 4)
    kernel, outputs = bind_kernel(case)
    kernel.solve(0, 1, 1e-4, 60, False)
    report = outputs["report"][0]
    assert report["status"] == OPTIMAL
    assert max(report["primal"], report["dual"], report["gap"]) <= 1e-4
    assert report["iterations"] < solve(case).iterations


def test_warm_start_finds_the_same_solution_in_fewer_iterations() -> None:
    """The problem changes by up to 1 %. A changed structure leads to a cold start."""
    rng = np.random.default_rng(45)
    cold, warm = 0, 0
    for _ in range(20):
        case = random_case(rng, 4)
        changed = replace(case, w=case.w * rng.uniform(0.99, 1.01, 6), J=case.J * rng.uniform(0.99, 1.01, case.J.shape))
        stacks = {"w": np.stack([case.w, changed.w]), "J": np.stack([case.J, changed.J])}
        kernel, outputs = bind_kernel(case, count=2, **stacks)
        kernel.solve(0, 1, 1e-9, 60, False)
        kernel.solve(1, 2, 1e-9, 60, True)
        alone, report = solve(changed), outputs["report"][1]
        assert report["status"] == alone.status
        cold, warm = cold + alone.iterations, warm + int(report["iterations"])
        if alone.status == OPTIMAL:
            assert objective(changed, outputs["f"][1]) == pytest.approx(objective(changed, alone.f), rel=1e-8)
    assert warm < 0.7 * cold
    slippery = np.stack([case.mu, case.mu * (np.arange(4) > 0)])
    kernel, outputs = bind_kernel(case, count=2, mu=slippery)
    kernel.solve(0, 2, 1e-9, 60, True)
    assert outputs["report"]["status"][1] == solve(replace(case, mu=slippery[1])).status
