"""solve() against an independent certificate, a second solver, analytical solutions and degenerate problems."""

from __future__ import annotations

import contextlib
import json
import math

import numpy as np
import pytest
from support.independent_check import independent_check
from support.random_problems import inner_forces, random_contacts, random_problem
from support.second_solver import second_optimum

from graspforce import (
    Actuation,
    Cone,
    Contact,
    ContactSet,
    ForceProblem,
    Objective,
    Status,
    solve,
)
from graspforce.contact.matrices import grasp_matrix
from graspforce.core.errors import InvalidInput
from graspforce.force.scale import scale

BATCHES = 20
PER_BATCH = 50  # 20 × 50 = 1,000 problems


@pytest.mark.parametrize("batch", range(BATCHES))
def test_solutions_agree_with_an_independent_certificate_and_a_second_solver(batch):
    rng = np.random.default_rng([2, batch])
    verdicts = []
    for _ in range(PER_BATCH):
        problem = random_problem(rng)
        answer, unit = solve(problem, explain=False), scale(problem)
        verdicts.append(answer.status)
        other = second_optimum(problem)
        if answer.status is Status.INFEASIBLE:
            assert answer.infeasibility.verified
            assert other is None
            continue
        assert answer.status is Status.OPTIMAL
        assert answer.certificate.verified
        seen = independent_check(problem, answer.f, answer.multipliers)
        whole = unit.cost + abs(seen.cost)
        force = max(unit.force, np.abs(answer.f).max())
        # The certificate's tolerance is 1e-8 of each unit; its residuals and the independent ones differ by rounding.
        assert seen.equilibrium <= 1e-8 * unit.force * max(1.0, unit.length)
        assert max(seen.cone, 0.0) <= 1e-8 * unit.force
        assert seen.limits <= 1e-8 * max([unit.force, *unit.torque])
        assert max(seen.wrong_signs, seen.dual_cone) * force <= 1e-8 * whole * max(1.0, force / max([*unit.torque, 1e-12]))
        assert abs(seen.cost - seen.bound) <= 2e-8 * whole
        assert abs(seen.cost - seen.bound) / whole == pytest.approx(answer.certificate.gap, abs=1e-8)
        sign = -1.0 if problem.objective.type == "margin" else 1.0
        assert sign * answer.objective == pytest.approx(seen.cost, rel=1e-12, abs=1e-12 * unit.cost)
        assert other is not None
        assert other == pytest.approx(answer.objective, rel=1e-6, abs=1e-6 * unit.cost)
        if abs(seen.cost) > 1e-3 * unit.cost:  # accurate relative to the objective, not only to its unit
            assert other == pytest.approx(answer.objective, rel=1e-6)
            assert abs(seen.cost - seen.bound) <= 1e-7 * abs(seen.cost)
    assert {Status.OPTIMAL, Status.INFEASIBLE} <= set(verdicts)


def without_one_limit(problem: ForceProblem) -> list[ForceProblem]:
    """Return the problem without one of its limits, for each limit; not where the margin would be unbounded."""
    relaxed, actuation, records = [], problem.actuation, [contact.to_dict() for contact in problem.contacts.contacts]
    for i, record in enumerate(records):
        for name in ("min_normal", "max_normal"):
            if record.get(name):
                without = {key: value for key, value in record.items() if key != name}
                contacts = [Contact.from_dict(without if j == i else other) for j, other in enumerate(records)]
                relaxed.append((contacts, actuation))
    for side in ("lower", "upper") if actuation is not None else ():
        for j in np.flatnonzero(np.isfinite(getattr(actuation, side))):
            limits = {"lower": actuation.lower.copy(), "upper": actuation.upper.copy()}
            limits[side][j] = -math.inf if side == "lower" else math.inf
            free = {name: [x if math.isfinite(x) else None for x in values] for name, values in limits.items()}
            relaxed.append((problem.contacts, Actuation(actuation.J, actuation.tau_u, weight=actuation.weight, **free)))
    problems = []
    for contacts, hand in relaxed:
        with contextlib.suppress(InvalidInput):
            problems.append(ForceProblem(contacts, problem.w, hand, problem.cone, problem.objective))
    return problems


@pytest.mark.parametrize("seed", range(60))
def test_dropping_a_limit_keeps_a_problem_feasible_and_never_raises_its_cost(seed):
    problem = random_problem(np.random.default_rng([3, seed]))
    solution, unit = solve(problem, explain=False), scale(problem)
    for other in without_one_limit(problem):
        answer = solve(other, explain=False)
        if solution.found:
            assert answer.status is Status.OPTIMAL
            gain = answer.objective - solution.objective  # the margin is maximised, all other objectives are minimised
            whole = unit.cost + abs(solution.objective)
            assert (-gain if problem.objective.type == "margin" else gain) <= 2e-8 * whole
        else:
            assert answer.status in (Status.OPTIMAL, Status.INFEASIBLE)


def opposed(**changes) -> list[Contact]:
    """Return two opposed contacts 4 m apart on the y axis."""
    given = {"friction": 0.1, **changes}
    return [Contact([0, -2, 0], [0, 1, 0], **given), Contact([0, 2, 0], [0, -1, 0], **given)]


def test_redundant_equilibrium_rows_are_allowed():
    """Case E2: rank G = 5, and the load of 10 N requires 50 N on each side: 2 μ f_n = 10."""
    problem = ForceProblem(opposed(), [0, 0, 10, 0, 0, 0], objective=Objective("max_normal"))
    assert np.linalg.matrix_rank(problem.G) == 5
    answer = solve(problem)
    assert answer.status is Status.OPTIMAL
    assert answer.objective == pytest.approx(50.0, rel=1e-8)
    assert [math.hypot(*f) for f in answer.forces] == pytest.approx([50.249378] * 2, rel=1e-7)


def test_contradictory_redundant_rows_are_infeasible():
    """Two point contacts cannot supply a moment about the line between them."""
    answer = solve(ForceProblem(opposed(), [0, 0, 10, 0, 1, 0]))
    assert answer.status is Status.INFEASIBLE
    assert abs(answer.infeasibility.wrench[4]) == pytest.approx(1.0, abs=1e-6)
    assert answer.infeasibility.nearest_wrench == pytest.approx([0, 0, 10, 0, 0, 0], abs=1e-6)


@pytest.mark.parametrize("kind", ["force", "max_normal", "sum_normal"])
def test_no_load_needs_no_force(kind):
    answer = solve(ForceProblem(opposed(), np.zeros(6), objective=Objective(kind)))
    assert answer.status is Status.OPTIMAL
    assert answer.objective == pytest.approx(0.0, abs=1e-8)
    # An error of 1e-8 in ½‖f‖² is an error of 1.4e-4 in f; the other costs are linear in f.
    assert answer.f == pytest.approx(np.zeros(6), abs=1.5e-4 if kind == "force" else 1e-7)


@pytest.mark.parametrize("cone", [Cone(), Cone("pyramid", 8, "inner"), Cone("pyramid", 8, "outer")])
def test_idle_contacts_do_not_change_the_optimum(cone):
    """Neither a contact with the limit f_n ≤ 0 nor one without a useful direction changes the closed form of E2."""
    idle = Contact([0, 0, 1], [0, 0, -1], 0.5, max_normal=0.0)
    useless = Contact([0, 0, 3], [0, 0, -1], 0.01)
    answer = solve(ForceProblem([*opposed(), idle, useless], [0, 0, 10, 0, 0, 0], cone=cone))
    assert answer.status is Status.OPTIMAL
    assert answer.forces[2] == pytest.approx(np.zeros(3), abs=1e-9)
    assert answer.forces[3] == pytest.approx(np.zeros(3), abs=1e-4)
    if cone.type == "exact":
        assert answer.objective == pytest.approx(10**2 * (1 + 1 / 0.1**2) / (2 * 2), rel=1e-7)


@pytest.mark.parametrize("kind", ["force", "max_normal", "sum_normal"])
@pytest.mark.parametrize("cone", [Cone(), Cone("pyramid", 8, "outer")])
def test_contact_with_zero_normal_force_limit_is_as_good_as_absent(kind, cone):
    """The contact is below the load, where it would reduce the cost."""
    idle = Contact([0, 0, -1], [0, 0, 1], 0.5, max_normal=0.0)
    without = solve(ForceProblem(opposed(), [0, 0, 10, 0, 0, 0], cone=cone, objective=Objective(kind)))
    answer = solve(ForceProblem([*opposed(), idle], [0, 0, 10, 0, 0, 0], cone=cone, objective=Objective(kind)))
    assert answer.status is Status.OPTIMAL
    assert answer.objective == pytest.approx(without.objective, rel=2e-8)
    assert answer.forces[2] == pytest.approx(np.zeros(3), abs=1e-8)


def test_contact_with_zero_normal_force_limit_has_no_margin():
    idle = Contact([0, 0, -1], [0, 0, 1], 0.5, max_normal=0.0)
    contacts = [*opposed(max_normal=80.0), idle]
    answer = solve(ForceProblem(contacts, [0, 0, 10, 0, 0, 0], objective=Objective("margin")))
    assert answer.status is Status.OPTIMAL
    assert answer.objective == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("kind", ["force", "max_normal", "sum_normal"])
@pytest.mark.parametrize("backend", ["clarabel", "proxqp", "quadprog"])
def test_zero_normal_force_limits_hold_zero_load_only(kind, backend):
    cone = Cone("pyramid", 4, "inner")
    still = ForceProblem(opposed(max_normal=0.0), np.zeros(6), cone=cone, objective=Objective(kind))
    answer = solve(still, backend)
    assert answer.status is Status.OPTIMAL
    assert answer.f == pytest.approx(np.zeros(6), abs=1e-12)
    assert solve(still.replace(w=[0, 0, 1e-3, 0, 0, 0]), backend).status is Status.INFEASIBLE


def test_equal_normal_force_limits_fix_the_normal_force():
    contacts = opposed(min_normal=60.0, max_normal=60.0)
    answer = solve(ForceProblem(contacts, [0, 0, 10, 0, 0, 0]))
    assert answer.status is Status.OPTIMAL
    assert [f[2] for f in answer.forces] == pytest.approx([60.0, 60.0], rel=1e-9)
    assert answer.objective == pytest.approx(0.5 * 2 * (60**2 + 5**2), rel=1e-8)


def test_frictionless_contacts_carry_normal_forces_only():
    """μ = 0 on a box with six contacts: the two normal forces along the load differ by exactly the load."""
    sides = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    contacts = [Contact(-0.03 * n, n, 0.0, min_normal=1.0) for n in sides]
    answer = solve(ForceProblem(contacts, [0, 0, 2.5, 0, 0, 0]))
    assert answer.status is Status.OPTIMAL
    assert [f[2] for f in answer.forces] == pytest.approx([1, 1, 1, 1, 3.5, 1], abs=1e-7)
    assert all(f[:2] == pytest.approx([0, 0], abs=0.0) for f in answer.forces)


@pytest.mark.parametrize("cone", [Cone(), Cone("pyramid", 16, "inner"), Cone("pyramid", 16, "outer")])
def test_soft_pair_carries_a_moment_about_its_line(cone):
    """Two soft fingers: a moment m about their line requires f_n = m/(2γ) each and no tangential force."""
    contacts = opposed(model="soft", torsional_friction=0.02, friction=0.5)
    answer = solve(ForceProblem(contacts, [0, 0, 0, 0, 0.3, 0], cone=cone, objective=Objective("sum_normal")))
    assert answer.status is Status.OPTIMAL
    assert answer.objective == pytest.approx(0.3 / 0.02, rel=1e-7)


def test_soft_contact_without_torsional_friction_is_a_point_contact():
    point = solve(ForceProblem(opposed(), [0, 0, 10, 0, 0, 0]))
    soft = solve(ForceProblem(opposed(model="soft", torsional_friction=0.0), [0, 0, 10, 0, 0, 0]))
    assert soft.objective == pytest.approx(point.objective, rel=1e-8)
    assert [f[3] for f in soft.forces] == [0.0, 0.0]


def test_margin_is_the_smallest_slip_margin():
    """Two contacts with normal forces up to N: s = μN − load/2 at both."""
    problem = ForceProblem(opposed(max_normal=80.0), [0, 0, 10, 0, 0, 0], objective=Objective("margin"))
    answer = solve(problem)
    assert answer.objective == pytest.approx(0.1 * 80 - 5, rel=1e-7)
    assert answer.slip_margin == pytest.approx([3.0, 3.0], rel=1e-7)
    assert answer.friction_used == pytest.approx([5 / 8, 5 / 8], rel=1e-7)


def test_margin_objective_is_infeasible_for_a_slipping_grasp():
    problem = ForceProblem(opposed(max_normal=40.0), [0, 0, 10, 0, 0, 0], objective=Objective("margin"))
    assert solve(problem).status is Status.INFEASIBLE


def test_torque_objective_balances_lever_arms():
    """One joint per finger, three horizontal contacts in a line, W = 1: f ∝ 1/lever²."""
    contacts = [Contact([-1, y, 0], [1, 0, 0], model="frictionless") for y in (-1.0, 1.0)]
    pushed = Contact([1, 0, 0], [-1, 0, 0], model="frictionless", min_normal=4.0, max_normal=4.0)
    actuation = Actuation(np.diag([0.1, 0.1, 0.1]), tau_u=[0.05, 0.05, 0.0])
    answer = solve(ForceProblem([*contacts, pushed], [0, 0, 0, 0, 0, 0], actuation))
    assert answer.f == pytest.approx([2, 2, 4], rel=1e-8)  # determined by the moment balance about z
    assert answer.torques == pytest.approx([0.25, 0.25, 0.4], rel=1e-8)
    assert answer.objective == pytest.approx(0.5 * (0.25**2 + 0.25**2 + 0.4**2), rel=1e-8)


def test_internal_force_cancels_bias_torques():
    """Unloaded pair, lever a: min Σ½(tau_u + a f)² with f equal on both sides gives f = −tau_u/a where tau_u < 0."""
    contacts = [Contact([0, y, 0], [0, -np.sign(y), 0], model="frictionless") for y in (-0.03, 0.03)]
    actuation = Actuation(np.diag([0.05, 0.05]), tau_u=[-0.1, -0.3])
    answer = solve(ForceProblem(contacts, np.zeros(6), actuation))
    assert answer.f == pytest.approx([4.0, 4.0], rel=1e-7)
    assert answer.objective == pytest.approx(0.5 * (0.1**2 + 0.1**2), rel=1e-7)


def test_joint_without_load_is_judged_by_its_bias_torque():
    contacts = opposed()
    J = np.zeros((6, 2))
    J[2, 0] = 0.05
    actuation = Actuation(J, [0.0, 0.3], upper=[None, 0.4], lower=[None, -0.4])
    beyond = Actuation(J, [0.0, 0.5], upper=[None, 0.4], lower=[None, -0.4])
    assert solve(ForceProblem(contacts, [0, 0, 10, 0, 0, 0], actuation, objective=Objective("force"))).found
    refused = solve(ForceProblem(contacts, [0, 0, 10, 0, 0, 0], beyond))
    assert refused.status is Status.INFEASIBLE
    assert refused.infeasibility.joints == (1,)
    assert refused.infeasibility.torque_factor == pytest.approx(0.5 / 0.4, rel=1e-6)


@pytest.mark.parametrize("force", [1e-4, 1e4])
@pytest.mark.parametrize("length", [1e-2, 1e2])
def test_solver_is_invariant_to_units(force, length):
    rng = np.random.default_rng(5)
    contacts = ContactSet.stack(random_contacts(rng, 4, ("point", "soft")))
    f = inner_forces(rng, contacts, 0.6)
    J, lever = rng.normal(size=(contacts.size, 6)) * 0.05, np.where(contacts.columns % 4 == 3, 1.0, length)
    small = solve(ForceProblem(contacts, grasp_matrix(contacts) @ f, Actuation(J)))
    records = [contact.to_dict() for contact in contacts.contacts]
    for record in records:
        record["position"] = [x * length for x in record["position"]]
        for name, unit in (("torsional_friction", length), ("min_normal", force), ("max_normal", force)):
            if name in record:
                record[name] *= unit
    scaled = [Contact.from_dict(record) for record in records]
    w = grasp_matrix(contacts) @ f * force * np.array([1, 1, 1, length, length, length])
    large = solve(ForceProblem(scaled, w, Actuation(J * lever[:, None])))
    assert large.status is Status.OPTIMAL
    assert large.objective == pytest.approx(small.objective * (force * length) ** 2, rel=1e-7)
    assert large.forces_object / force == pytest.approx(small.forces_object, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("kind", ["force", "max_normal", "sum_normal", "torque"])
@pytest.mark.parametrize("beyond", [1e6, 1e12])
def test_unreachable_limits_do_not_change_the_optimum(kind, beyond):
    J = np.zeros((6, 2))
    J[2, 0] = J[5, 1] = 0.05
    bound = Actuation(J, lower=[-beyond] * 2, upper=[beyond] * 2)
    limited = solve(ForceProblem(opposed(max_normal=beyond), [0, 0, 10, 0, 0, 0], bound, objective=Objective(kind)))
    free = solve(ForceProblem(opposed(), [0, 0, 10, 0, 0, 0], Actuation(J), objective=Objective(kind)))
    assert limited.status is Status.OPTIMAL
    assert limited.objective == pytest.approx(free.objective, rel=2e-8)


SIZES = [5e-324, 1e-308, 1e-154, 1e-100, 1.0, 1e100, 1e154, 1e200, 1e308]


@pytest.mark.parametrize("seed", range(60))
def test_extreme_numbers_give_finite_records_without_warnings(seed):
    """Ten problems per seed with some extreme numbers: rejected, or solved without warning and infinity."""
    rng = np.random.default_rng([41, seed])

    def odd(usual: float) -> float:
        return float(rng.choice(SIZES)) if rng.random() < 0.2 else usual

    for _ in range(10):
        contacts = [
            Contact(
                rng.uniform(-1, 1, 3) * odd(0.05),
                rng.normal(size=3),
                odd(0.5),
                rng.choice(["frictionless", "point", "soft"]),
                torsional_friction=odd(0.01),
                min_normal=rng.choice([0.0, odd(0.1)]),
                max_normal=rng.choice([None, 1e308]),
            )
            for _ in range(int(rng.integers(1, 4)))
        ]
        J = rng.uniform(-1, 1, (ContactSet.stack(contacts).size, 2)) * odd(0.05)
        actuation = Actuation(J, [odd(0.02), -odd(0.02)], upper=[odd(1.0), None], weight=[odd(1.0), 1.0])
        objective = Objective(str(rng.choice(["force", "torque", "max_normal", "sum_normal", "margin"])))
        cone = Cone() if rng.random() < 0.5 else Cone("pyramid", 5, "outer")
        try:
            problem = ForceProblem(contacts, [0, odd(0.0), -odd(1.0), 0, odd(0.0), 0], actuation, cone, objective)
        except InvalidInput:
            continue
        json.dumps(solve(problem, explain=bool(rng.random() < 0.2)).to_dict(), allow_nan=False)
