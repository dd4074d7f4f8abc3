"""Forces that hold for a whole set of errors: closed forms, samples of the set, monotonicity, and what is refused."""

from __future__ import annotations

import dataclasses
import json

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from support.other_units import in_other_units
from support.random_problems import inner_forces, random_actuation, random_contacts

import graspforce as gf
from benchmarks.robust_samples import sample
from graspforce.core.errors import InvalidInput
from graspforce.force import robust_program
from graspforce.force.robust_set import RobustSet
from graspforce.force.uncertainty import Uncertainty

RING = "ring/3-force"  # 3 contacts around a vertical axis, friction 0.5, weight 1 N: cost W²(1 + 1/μ²)/6
SLIP = 1e-9  # N: rounding of a margin
ERRORS = {
    "friction": {"friction_error": 0.2},
    "mass": {"mass_error": 0.2, "centre_of_mass_error": [0.002, 0.003, 0.0]},
    "wrenches": {"wrenches": [[0.3, 0, 0, 0, 0, 0], [0, -0.2, 0.1, 0, 0.003, 0]], "friction_error": 0.1},
    "ellipsoid": {"wrench_ellipsoid": np.diag([0.2, 0.1, 0.2, 0.003, 0.003, 0.002])},
    "places": {"position_error": 0.001},
    "normals": {"normal_error": 0.08, "friction_error": 0.1},
    "torques": {"torque_error": 0.03},
    "margin": {"slip_margin": 0.1, "mass_error": 0.1},
    "all": {
        "friction_error": 0.1,
        "mass_error": 0.05,
        "centre_of_mass_error": 0.001,
        "wrench_ellipsoid": np.diag([0.05, 0.05, 0.05, 5e-4, 5e-4, 5e-4]),
        "position_error": 5e-4,
        "normal_error": 0.02,
        "torque_error": 0.01,
    },
}


def with_errors(problem: gf.ForceProblem, **errors) -> gf.ForceProblem:
    return dataclasses.replace(problem, uncertainty=Uncertainty(**errors))


def ring(**errors) -> gf.ForceProblem:
    return with_errors(gf.problems.load(RING).problem, **errors)


def random_problem(seed: int, kind: str = "torque", models: tuple[str, ...] = ("point",)) -> gf.ForceProblem:
    """Return a feasible problem of four contacts with a hand, whose forces have room for errors."""
    rng = np.random.default_rng(seed)
    contacts = gf.ContactSet.stack(random_contacts(rng, 4, models))
    f = inner_forces(rng, contacts, 0.3)
    w = gf.ForceProblem(contacts, np.zeros(6)).G @ f
    objective = gf.Objective(kind, 1e-6) if kind == "torque" else gf.Objective(kind)
    return gf.ForceProblem(contacts, w, random_actuation(rng, contacts, f), objective=objective)


@pytest.mark.parametrize(
    ("errors", "load", "mu"),
    [
        ({}, 1.0, 0.5),
        ({"friction_error": 0.2}, 1.0, 0.4),
        ({"normal_error": 0.1}, 1.0, np.tan(np.arctan(0.5) - 0.1)),
        ({"normal_error": 0.1, "friction_error": 0.2}, 1.0, np.tan(np.arctan(0.4) - 0.1)),
    ],
    ids=["exact data", "friction", "normals", "both"],
)
def test_squeeze_of_a_ring_has_its_closed_form(errors, load, mu):
    solution = gf.solve(ring(**errors))
    assert solution.objective == pytest.approx(load**2 * (1.0 + 1.0 / mu**2) / 6.0, rel=1e-6)
    assert solution.cost_bound == pytest.approx(solution.objective, rel=1e-9)
    assert solution.robust.least_friction == pytest.approx(np.full(3, np.tan(np.arctan(mu) + errors.get("normal_error", 0))))


@pytest.mark.parametrize("kept", [0.0, 0.1])
def test_squeeze_for_a_mass_interval_presses_for_the_largest_mass(kept):
    """Each finger bears W/3 and presses with ((1 + e) W/3 + s)/μ' against (1 + e) W, with μ' = μ (1 − e_f)."""
    e, mu = 0.3, 0.4
    solution = gf.solve(ring(friction_error=0.2, mass_error=e, slip_margin=kept))
    normal = ((1.0 + e) / 3.0 + kept) / mu
    assert solution.objective == pytest.approx(1.5 * (normal**2 + 1.0 / 9.0), rel=1e-6)
    assert solution.robust.worst.guaranteed == pytest.approx(np.full(3, kept), abs=1e-7)
    if kept == 0.0:
        assert solution.robust.error_factor == pytest.approx((1.0, 1.0), rel=1e-5)


def test_pinch_bears_a_force_across_as_its_polytope():
    """Opposed contacts share a tangential force equally: each bears (W + P)/2 and presses with that over μ."""
    contacts = [gf.Contact([0, y, 0], [0, -np.sign(y), 0], 0.5) for y in (-0.03, 0.03)]
    problem = gf.ForceProblem(contacts, [0, 0, 2.0, 0, 0, 0])
    solution = gf.solve(with_errors(problem, wrenches=[[0, 0, 0.4, 0, 0, 0], [0, 0, -0.2, 0, 0, 0]]))
    assert solution.f[[2, 5]] == pytest.approx([2.4, 2.4], rel=1e-6)


@pytest.mark.parametrize(
    ("kind", "exact"), [("force", 0.5 * 0.65888534), ("max_normal", 0.49108896), ("sum_normal", 1.47397020)]
)
def test_nose_cone_with_uncertain_friction_is_that_of_the_least_friction(kind, exact):
    """Known answers of Lobo et al. (1998) for μ = 0.3; here μ = 0.375 with an error of 20 %."""
    case = gf.problems.load("nose-cone/5-force").problem
    assert case.contacts.mu == pytest.approx(np.full(5, 0.3))
    rougher = case.replace(mu=np.full(5, 0.375))
    errors = Uncertainty(friction_error=0.2)
    problem = gf.ForceProblem(rougher.contacts, case.w, objective=gf.Objective(kind), uncertainty=errors)
    assert gf.solve(problem).objective == pytest.approx(exact, rel=1e-6)


def test_opposed_contacts_with_uncertain_mass_have_their_closed_form():
    """A load of 10 along z, μ = 0.1: each contact bears 5 (1 + e) and presses with that over μ (1 − e_f)."""
    contacts = [gf.Contact([0, y, 0], [0, -np.sign(y), 0], 0.1) for y in (2.0, -2.0)]
    problem = gf.ForceProblem(contacts, [0, 0, 10.0, 0, 0, 0], objective=gf.Objective("max_normal"))
    solution = gf.solve(with_errors(problem, mass_error=0.25, friction_error=0.2))
    assert solution.objective == pytest.approx(5.0 * 1.25 / 0.08, rel=1e-6)


def test_ellipsoid_of_axial_forces_equals_an_interval():
    ball = gf.solve(ring(wrench_ellipsoid=[[0], [0], [0.3], [0], [0], [0]]))
    ends = gf.solve(ring(wrenches=[[0, 0, 0.3, 0, 0, 0], [0, 0, -0.3, 0, 0, 0]]))
    assert ball.objective == pytest.approx(ends.objective, rel=1e-6)


@pytest.mark.parametrize("name", ERRORS)
@pytest.mark.parametrize("seed", [1, 2])
def test_no_sample_of_the_set_slips_or_exceeds_a_limit(name, seed):
    problem = with_errors(random_problem(seed), **ERRORS[name])
    solution = gf.solve(problem)
    assert solution.found
    outcome = sample(problem, solution.f, 4_000, np.random.default_rng(seed))
    kept = problem.uncertainty.slip_margin
    assert outcome.margin.min() >= kept - SLIP
    assert outcome.margin.min() >= solution.robust.worst.guaranteed.min() - SLIP
    assert outcome.exceeded <= 1e-7
    assert solution.cost_bound <= solution.objective * (1.0 + 1e-9)


@pytest.mark.parametrize("name", ["mass", "normals", "places"])
def test_no_sample_slips_with_soft_contacts(name):
    errors = Uncertainty(**ERRORS[name]).times(0.25)
    problem = dataclasses.replace(random_problem(5, models=("soft", "point")), uncertainty=errors)
    solution = gf.solve(problem)
    assert solution.found
    assert sample(problem, solution.f, 4_000, np.random.default_rng(6)).margin.min() >= -SLIP


@pytest.mark.parametrize("name", ["friction", "mass", "wrenches", "normals"])
def test_a_member_one_percent_beyond_the_limit_slips(name):
    """The contact that the certificate names slips with the named friction and wrench, whose forces balance."""
    problem = with_errors(random_problem(1), **ERRORS[name])
    solution = gf.solve(problem)
    holds, slips = solution.robust.error_factor
    assert holds == pytest.approx(slips, rel=1e-6)
    assert solution.robust.slipping_member(0.99 * holds) is None
    member = solution.robust.slipping_member(1.01 * slips)
    margins = gf.ForceProblem(problem.contacts, member.wrench).replace(mu=member.friction).cone_margins(member.forces)
    assert margins[member.contact] < 0.0
    assert problem.G @ member.forces == pytest.approx(member.wrench, abs=1e-9)


@given(st.integers(0, 20), st.sampled_from(sorted(ERRORS)), st.floats(0.0, 1.0))
@settings(max_examples=25, deadline=None)
def test_a_larger_set_never_costs_less(seed, name, share):
    problem, errors = random_problem(seed), Uncertainty(**ERRORS[name])
    small = gf.solve(dataclasses.replace(problem, uncertainty=errors.times(share)))
    large = gf.solve(dataclasses.replace(problem, uncertainty=errors))
    assert small.found or not large.found
    if small.found and large.found:
        assert large.objective >= small.objective * (1.0 - 1e-7) - 1e-9


@pytest.mark.parametrize("kind", ["torque", "force", "sum_normal"])
@pytest.mark.parametrize("seed", [2, 7, 11, 47])
def test_solver_finds_the_same_squeeze_as_the_whole_program(kind, seed):
    """Steps of a `Solver` use shifted nominal problems; the reference is one cone program with all vertices."""
    problem = with_errors(random_problem(seed, kind), friction_error=0.15, mass_error=0.1)
    solver = gf.Solver(problem)
    for scale in (1.0, 0.97, 1.02):
        step, whole = solver.solve(w=scale * problem.w), gf.solve(problem.replace(w=scale * problem.w))
        assert step.status is whole.status
        if whole.found:
            assert step.objective == pytest.approx(whole.objective, rel=1e-6)
            assert step.robust.worst.guaranteed.min() >= -SLIP
            assert step.robust.worst.exceeded <= 1e-7
            assert step.certificate.verified


@pytest.mark.parametrize("kind", ["torque", "force"])
def test_solver_finds_forces_that_two_vertices_limit(kind):
    """Over many grasps and mass intervals, two vertices limit a contact in some; the steps find the same optimum in all."""
    counts = {"structured": 0, "clarabel": 0}
    for seed in range(30):
        problem = with_errors(random_problem(seed, kind), friction_error=0.15, mass_error=0.1, slip_margin=0.02)
        step, whole = gf.Solver(problem).solve(), gf.solve(problem)
        assert step.status is whole.status
        if whole.found:
            counts[step.backend] += 1
            assert step.objective == pytest.approx(whole.objective, rel=1e-6)
            assert step.robust.worst.guaranteed.min() >= 0.02 - SLIP
    assert counts["structured"] > 2 * counts["clarabel"]


def test_solver_with_a_box_of_centres_of_mass_equals_the_whole_program():
    for seed in (1, 5, 9, 13):
        problem = with_errors(random_problem(seed), mass_error=0.05, centre_of_mass_error=[0.001, 0.002, 0.001])
        step, whole = gf.Solver(problem).solve(), gf.solve(problem)
        assert step.status is whole.status
        if whole.found:
            assert step.objective == pytest.approx(whole.objective, rel=1e-6)


def test_solver_follows_changes_of_the_contacts():
    problem = ring(friction_error=0.2, mass_error=0.1)
    solver = gf.Solver(problem)
    solver.solve()
    changed = solver.solve(mu=[0.6, 0.6, 0.6])
    assert changed.objective == pytest.approx(gf.solve(problem.replace(mu=[0.6, 0.6, 0.6])).objective, rel=1e-6)
    assert solver.problem.contacts.mu.tolist() == [0.6, 0.6, 0.6]


@pytest.mark.parametrize("name", ["friction", "mass", "places", "normals", "torques"])
def test_squeeze_does_not_depend_on_the_origin(name):
    """The wrench about another O has the moment of its force; errors stay as they are."""
    problem, shift = random_problem(4), np.array([0.3, -0.2, 0.5])
    moved = problem.replace(
        p=problem.contacts.p_OC + shift, w=problem.w + np.append(np.zeros(3), np.cross(shift, problem.w[:3]))
    )
    here, there = gf.solve(with_errors(problem, **ERRORS[name])), gf.solve(with_errors(moved, **ERRORS[name]))
    assert there.objective == pytest.approx(here.objective, rel=1e-6)
    assert there.f == pytest.approx(here.f, abs=1e-5 * np.abs(here.f).max())


@pytest.mark.parametrize("name", ["friction", "mass", "places", "normals"])
def test_squeeze_scales_with_the_units(name):
    """Forces in mN and lengths in mm: the same forces, if the errors in metres are in the same units."""
    problem = random_problem(4)
    errors = Uncertainty(**ERRORS[name])
    scaled = in_other_units(problem, 1e3, 1e3)
    factor = 1e3 if name in ("mass", "places") else 1.0
    in_mm = Uncertainty(
        friction_error=errors.friction_error,
        mass_error=errors.mass_error,
        normal_error=errors.normal_error,
        centre_of_mass_error=factor * errors.centre_of_mass_error,
        position_error=factor * errors.position_error,
    )
    here = gf.solve(dataclasses.replace(problem, uncertainty=errors, objective=gf.Objective("force")))
    there = gf.solve(dataclasses.replace(scaled, uncertainty=in_mm, objective=gf.Objective("force")))
    assert there.f == pytest.approx(1e3 * here.f, rel=1e-5, abs=1e-2 * np.abs(here.f).max())


def test_bounds_of_inexact_sets_contain_the_least_cost():
    """A dense sampling of an ellipsoid is a relaxation: its optimum is between the bounds."""
    shape = np.diag([0.2, 0.2, 0.2, 0.004, 0.004, 0.004])
    solution = gf.solve(ring(wrench_ellipsoid=shape))
    directions = np.random.default_rng(8).normal(size=(60, 6))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    relaxed = gf.solve(ring(wrenches=directions @ shape))
    assert relaxed.objective <= solution.objective * (1.0 + 1e-7)
    assert solution.cost_bound <= solution.objective


def test_errors_that_no_squeeze_survives_are_proven_infeasible():
    contacts = [gf.Contact([0, y, 0], [0, -np.sign(y), 0], 0.5, max_normal=2.5) for y in (-0.03, 0.03)]
    problem = gf.ForceProblem(contacts, [0, 0, 2.0, 0, 0, 0])
    assert gf.solve(with_errors(problem, mass_error=0.2)).found  # 2.4 N at each contact
    for errors in ({"mass_error": 0.3}, {"friction_error": 0.5}, {"wrenches": [[0, 0, 0, 0, 0.1, 0]]}):
        solution = gf.solve(with_errors(problem, **errors))
        assert solution.status is gf.Status.INFEASIBLE
        assert solution.infeasibility.explanation
        y = solution.infeasibility.multipliers.about(np.zeros(3)).y
        assert np.linalg.norm(y) > 0.0
        if "wrenches" in errors:  # a direction in which no forces act
            assert np.abs(problem.G.T @ y).max() < 1e-9 * np.linalg.norm(y)
            assert abs(y @ errors["wrenches"][0]) > 0.0
        assert gf.Solver(with_errors(problem, **errors)).solve().status is gf.Status.INFEASIBLE


def test_records_keep_the_errors():
    problem = ring(**{name: value for name, value in ERRORS["all"].items() if name != "torque_error"})
    record = json.loads(json.dumps(problem.to_dict()))
    again = gf.ForceProblem.from_dict(record)
    assert again.to_dict() == problem.to_dict()
    solution = gf.solve(again)
    stored = json.loads(json.dumps(solution.to_dict()))
    assert stored["robust"]["statement"] == solution.robust.statement
    assert "robust" not in gf.solve(gf.problems.load(RING).problem).to_dict()
    received = gf.Solution.from_dict(stored)
    assert received.robust.statement == solution.robust.statement
    assert received.robust.to_dict() == stored["robust"]
    assert received.to_dict()["robust"] == stored["robust"]


@pytest.mark.parametrize(
    ("errors", "field"),
    [
        ({"friction_error": 1.0}, "friction_error"),
        ({"friction_error": [0.1, 0.1]}, "uncertainty.friction_error"),
        ({"mass_error": -0.1}, "mass_error"),
        ({"centre_of_mass_error": [1, 2]}, "centre_of_mass_error"),
        ({"wrenches": [[1, 2, 3]]}, "wrenches"),
        ({"wrench_ellipsoid": np.ones((5, 2))}, "wrench_ellipsoid"),
        ({"normal_error": 0.5}, "uncertainty.normal_error"),
        ({"torque_error": [0.1, 0.1]}, "uncertainty.torque_error"),
        ({"slip_margin": np.inf}, "slip_margin"),
    ],
)
def test_errors_outside_their_range_are_refused(errors, field):
    with pytest.raises(InvalidInput, match=f"^{field}"):
        ring(**errors)


def test_places_so_uncertain_that_the_grasp_may_lose_rank_are_refused():
    with pytest.raises(InvalidInput, match=r"^uncertainty.position_error.*may leave no reaction"):
        gf.solve(ring(position_error=0.5))
    contacts = [gf.Contact([0, y, 0], [0, -np.sign(y), 0], 0.5) for y in (-0.03, 0.03)]
    with pytest.raises(InvalidInput, match="position_error"):
        RobustSet(with_errors(gf.ForceProblem(contacts, [0, 0, 1, 0, 0, 0]), position_error=1e-4))


def test_objectives_and_cones_that_have_no_meaning_with_errors_are_refused():
    contacts = [gf.Contact([0, y, 0], [0, -np.sign(y), 0], 0.5, max_normal=5.0) for y in (-0.03, 0.03)]
    with pytest.raises(InvalidInput, match="slip_margin is given"):
        gf.ForceProblem(contacts, np.zeros(6), objective=gf.Objective("margin"), uncertainty=Uncertainty())
    with pytest.raises(InvalidInput, match="outer pyramids allow slip"):
        gf.ForceProblem(contacts, np.zeros(6), cone=gf.Cone("pyramid", 8, "outer"), uncertainty=Uncertainty())


def test_ray_proves_infeasibility_whatever_its_length(monkeypatch):
    """Numbers of a diverging solver may be so large that their squares overflow."""
    contacts = [gf.Contact([0, y, 0], [0, -np.sign(y), 0], 0.5, max_normal=2.5) for y in (-0.03, 0.03)]
    problem = with_errors(gf.ForceProblem(contacts, [0, 0, 2.0, 0, 0, 0]), mass_error=0.3)
    solved = robust_program._solve
    for length in (1e-150, 1.0, 1e160):
        monkeypatch.setattr(robust_program, "_solve", lambda *args, c=length: stretched(solved(*args), c))
        solution = gf.solve(problem)
        assert solution.status is gf.Status.INFEASIBLE
        assert solution.certificate.verified


def test_solver_that_diverges_yields_no_forces(monkeypatch):
    solved = robust_program._solve
    monkeypatch.setattr(robust_program, "_solve", lambda *args: stretched(solved(*args), 1e160))
    assert not gf.solve(ring(friction_error=0.2)).found


def stretched(result, length):
    """Return a solver's result with its numbers multiplied by a length."""
    return dataclasses.replace(result, x=length * result.x, z=length * result.z)
