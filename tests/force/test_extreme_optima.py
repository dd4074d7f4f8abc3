"""Problems far from their own units: large forces, small costs, unbounded margins, and distant contacts."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce import Actuation, Contact, ForceProblem, InvalidInput, Objective, Solution, Solver, Status, solve
from graspforce.force.backends import clarabel, registry
from graspforce.force.certificate import certify


def wedge(angle: float, max_normal: float | None = None) -> ForceProblem:
    """Return two frictionless contacts that supply 1 N upwards; their normals are inclined upwards by an angle, rad."""
    normals = [(side * np.cos(angle), 0.0, np.sin(angle)) for side in (1.0, -1.0)]
    contacts = [Contact((0, 0, 0), n, model="frictionless", max_normal=max_normal) for n in normals]
    return ForceProblem(contacts, (0, 0, 1, 0, 0, 0))


@pytest.mark.parametrize("max_normal", [None, 1e9])
@pytest.mark.parametrize("angle", [1e-3, 1e-5, 1e-6, 1e-7])
def test_a_flat_wedge_needs_forces_of_half_the_inverse_angle(angle, max_normal):
    solution = solve(wedge(angle, max_normal), explain=False)
    assert solution.status is Status.OPTIMAL
    np.testing.assert_allclose(solution.f, 0.5 / np.sin(angle), rtol=1e-8)


@pytest.mark.parametrize("angle", [1e-8, 1e-9])
def test_certified_forces_of_a_flatter_wedge_are_right(angle):
    """The forces are a difference of large numbers: rounding allows the looser tolerance only."""
    solution = solve(wedge(angle))
    assert solution.found
    np.testing.assert_allclose(solution.f, 0.5 / angle, rtol=1e-5)


@pytest.mark.parametrize("angle", [0.0, -1e-7, -0.1])
def test_a_wedge_that_points_down_is_infeasible_for_all_forces_in_reach(angle):
    """Every proof states its reach. With a limit on the forces it holds for all of them."""
    unlimited, limited = solve(wedge(angle)), solve(wedge(angle, 1e9))
    assert unlimited.status is Status.INFEASIBLE
    reach = unlimited.infeasibility.reach
    assert reach is None or (reach >= 1e9 and f"up to a sum of {reach:.2g} N" in unlimited.infeasibility.explanation)
    assert limited.status is Status.INFEASIBLE
    assert limited.infeasibility.reach is None


def test_the_reach_of_a_proof_survives_its_record():
    record = solve(wedge(0.0)).to_dict()
    assert Solution.from_dict(record).infeasibility.reach == record["infeasibility"]["reach"]


def test_refuses_a_margin_that_no_limit_bounds():
    """The torque limits act on forces along x, and the pair squeezes along y."""
    contacts = [Contact((0, y, 0), (0, -y, 0), 0.5) for y in (1.0, -1.0)]
    J = np.zeros((6, 2))
    J[0, 0] = 1.0
    actuation = Actuation(J, lower=[-1, -1], upper=[1, 1])
    problem = ForceProblem(contacts, np.zeros(6), actuation, objective=Objective("margin"))
    for refuse in (lambda: solve(problem), lambda: Solver(problem).solve()):
        with pytest.raises(InvalidInput, match="no limit bounds the margin"):
            refuse()
    J[2, 1] = 1.0  # now the second motor carries the squeeze, up to 1 N
    limited = Actuation(J, lower=[-1, -1], upper=[1, 1])
    bounded = solve(ForceProblem(contacts, np.zeros(6), limited, objective=Objective("margin")))
    assert bounded.objective == pytest.approx(0.5, rel=1e-7)


def four_fingers(weight: float) -> ForceProblem:
    """Return a grasp in which internal forces can relieve one motor of weight 1; the others have a smaller weight."""
    normals = [(np.cos(t), np.sin(t), 0.0) for t in (0.0, 1.5, 3.0, 4.5)]
    contacts = [Contact(0.03 * np.array(n), -np.array(n), 1.0) for n in normals]
    J = np.random.default_rng(1).normal(size=(12, 9)) * 0.05
    return ForceProblem(contacts, (0, 0, 1, 0, 0, 0), Actuation(J, weight=[1.0] + [weight] * 8))


@pytest.mark.parametrize(("weight", "tolerance"), [(1e-4, 1e-7), (1e-8, 1e-6), (1e-10, 1e-5), (1e-12, 1e-3)])
def test_small_objectives_are_solved_to_their_own_size(weight, tolerance):
    """As the weight tends to 0, the heavy motor carries nothing: the objective tends to the weight times a constant."""
    limit = 8.583908e-3  # of objective/weight
    for solution in (solve(four_fingers(weight)), Solver(four_fingers(weight)).solve()):
        assert solution.status is Status.OPTIMAL
        assert solution.objective_gap <= tolerance
        if weight <= 1e-8:
            assert solution.objective / weight == pytest.approx(limit, rel=max(tolerance, 1e-5))


def test_the_objective_gap_bounds_the_error_of_the_objective():
    """Forces moved off the optimum have a certified gap that covers their excess cost."""
    problem = four_fingers(1.0)
    best = solve(problem)
    assert best.objective_gap <= 1e-7
    worse = solve(problem, "clarabel", settings=None)
    assert abs(worse.objective - best.objective) <= (best.objective_gap + worse.objective_gap) * best.objective + 1e-12
    assert Solution.from_dict(best.to_dict()).objective_gap == best.objective_gap


def test_refuses_a_contact_whose_distance_hides_the_moments_of_the_others():
    ring = [Contact((np.cos(t), np.sin(t), 0), (-np.cos(t), -np.sin(t), 0), 0.5) for t in (0.0, 2.0, 4.0)]
    far = Contact((1e10, 0, 0), (-1, 0, 0), 0.5)
    with pytest.raises(InvalidInput, match=r"contacts\[3\].position"):
        ForceProblem([*ring, far], (0, 0, 0, 0, 0, 1.0))
    near = ForceProblem([*ring, Contact((100.0, 0, 0), (-1, 0, 0), 0.5)], (0, 0, 0, 0, 0, 1.0))
    solution = solve(near)
    assert solution.status is Status.OPTIMAL
    np.testing.assert_allclose(near.G @ solution.f, near.w, atol=1e-6)


@pytest.mark.parametrize("length", [1.0, 0.01, 0.3])
def test_the_moment_length_weighs_moments_of_soft_contacts(length):
    """Two soft contacts share a moment about their common normal: f_n = m/(2γ) each, and ½‖f‖² = f_n² + (m/2)²/ℓ²."""
    gamma, m = 0.02, 0.5  # m, N·m
    contacts = [Contact((x, 0, 0), (-x, 0, 0), 0.5, "soft", torsional_friction=gamma) for x in (0.03, -0.03)]
    problem = ForceProblem(contacts, (0, 0, 0, m, 0, 0), objective=Objective("force", moment_length=length))
    solution = solve(problem)
    assert solution.status is Status.OPTIMAL
    assert solution.objective == pytest.approx((m / (2 * gamma)) ** 2 + (m / (2 * length)) ** 2, rel=1e-7)
    assert ForceProblem.from_dict(problem.to_dict()).objective == problem.objective


def test_the_moment_length_makes_the_cost_independent_of_the_unit_of_length():
    """In millimetres, moments and torsional friction grow by 1000, and so does the length that weighs them."""
    values = []
    for unit in (1.0, 1e3):
        contacts = [
            Contact(np.multiply(p, unit), n, 0.4, "soft", torsional_friction=0.01 * unit)
            for p, n in (((0.03, 0, 0), (-1, 0, 0)), ((-0.02, 0.02, 0), (1, -0.5, 0)), ((-0.02, -0.02, 0), (1, 0.5, 0)))
        ]
        w = np.array([0, 0, 1.0, 0.004 * unit, 0, 0.01 * unit])
        values.append(solve(ForceProblem(contacts, w, objective=Objective("force", moment_length=0.02 * unit))).objective)
    assert values[0] == pytest.approx(values[1], rel=1e-6)


@pytest.mark.parametrize("length", [0.0, -1.0, np.nan])
def test_rejects_an_invalid_moment_length(length):
    with pytest.raises(InvalidInput, match="moment_length"):
        Objective("force", moment_length=length)


def test_rejects_a_moment_length_without_squared_forces():
    with pytest.raises(InvalidInput, match="moment_length"):
        Objective("sum_normal", moment_length=0.1)


def test_multipliers_of_large_forces_pass_the_same_certificate():
    problem = wedge(1e-7)
    solution = solve(problem)
    assert solution.backend == registry.general_backend().name == clarabel.ClarabelBackend.name
    assert certify(problem, solution.f, solution.multipliers).verified
