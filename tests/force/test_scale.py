"""The units of a problem scale with it and do not depend on O, and no wrong solution passes because a unit is too large."""

from __future__ import annotations

import numpy as np
import pytest
from support.random_problems import random_problem

from graspforce import Actuation, Contact, ForceProblem, Multipliers, Objective, Status, solve
from graspforce.force.certificate import certify, certify_infeasibility
from graspforce.force.scale import scale


def pair(**changes) -> list[Contact]:
    """Return two opposed contacts 10 cm apart on the y axis."""
    given = {"friction": 0.5, **changes}
    return [Contact([0, y, 0], [0, -np.sign(y), 0], **given) for y in (-0.05, 0.05)]


def levers(*each: float) -> np.ndarray:
    """Return the Jacobian of one joint per normal force of the pair, with the given lever arms."""
    J = np.zeros((6, len(each)))
    for j, lever in enumerate(each):
        J[2 + 3 * j, j] = lever
    return J


def moved(problem: ForceProblem, origin: np.ndarray) -> ForceProblem:
    """Return the problem with O at ``origin``: positions and the wrench's moment change."""
    p = problem.contacts.p_OC - origin
    w = np.append(problem.w[:3], problem.w[3:] - np.cross(origin, problem.w[:3]))
    return problem.replace(p=p, w=w)


@pytest.mark.parametrize("distance", [1.0, 1e2, 1e4])
@pytest.mark.parametrize("seed", range(10))
def test_solution_does_not_depend_on_the_origin(seed, distance):
    rng = np.random.default_rng([31, seed])
    near = random_problem(rng)
    far = moved(near, distance * rng.normal(size=3))
    # Positions have 16 digits: at 1e4 m they are rounded to 1e-12 m, which is 1e-10 of a small grasp.
    rounding = 1e-12 + 1e-13 * distance  # relative
    one, other = scale(near), scale(far)
    for unit in ("force", "length", "torque", "cost"):
        assert getattr(other, unit) == pytest.approx(getattr(one, unit), rel=rounding)
    here, there = solve(near, explain=False), solve(far, explain=False)
    assert there.status is here.status
    if here.found:
        assert there.objective == pytest.approx(here.objective, rel=1e-6, abs=1e-6 * one.cost)


def test_nearest_wrench_transforms_with_the_origin():
    """At most 2 μ N = 5 N of 8 N can be lifted, for every reference point of moments."""
    near = ForceProblem(pair(friction=0.25, max_normal=10.0), [0, 0, 8.0, 0, 0, 0])
    origin = np.array([30.0, -20.0, 10.0])
    held = moved(near.replace(w=[0, 0, 5.0, 0, 0, 0]), origin).w
    assert solve(moved(near, origin)).infeasibility.nearest_wrench == pytest.approx(held, abs=1e-6)


@pytest.mark.parametrize("load", [1e-3, 1e-9, 0.0])
@pytest.mark.parametrize("least", [1.0, 1e4])
def test_required_torque_sets_the_force_unit_under_a_small_load(load, least):
    """tau ≥ least on lever arms of 5 cm requires 20 N per N·m, and normal forces have no limit."""
    actuation = Actuation(levers(0.05, 0.05), lower=[least, least])
    problem = ForceProblem(pair(), [0, 0, load, 0, 0, 0], actuation)
    answer = solve(problem)
    assert answer.status is Status.OPTIMAL
    assert answer.torques == pytest.approx([least, least], rel=1e-7)
    nothing = np.zeros(2)
    both = Multipliers(np.zeros(6), nothing, nothing, np.ones(2), nothing, nothing)
    assert not certify_infeasibility(problem, both).certificate.verified


@pytest.mark.parametrize("mu", [1e-3, 1e-5, 1e-7, 1e-9])
def test_small_friction_with_unbounded_normal_force_is_feasible(mu):
    """f_n = w/(2μ) is feasible; the multipliers y = e_z without friction must not refute it."""
    problem = ForceProblem(pair(friction=mu), [0, 0, 1.0, 0, 0, 0])
    nothing, none = np.zeros(2), np.zeros(0)
    lift = Multipliers(np.array([0, 0, 1.0, 0, 0, 0]), nothing, nothing, none, none, nothing)
    assert not certify_infeasibility(problem, lift).certificate.verified
    assert solve(problem, explain=False).status is not Status.INFEASIBLE


@pytest.mark.parametrize("load", [1e-3, 1e-6, 1e-9])
def test_bias_torques_set_the_force_unit_under_a_small_load(load):
    """f_n = −tau_u/lever makes both torques zero; a load of milligrams does not change that."""
    problem = ForceProblem(pair(), [0, 0, load, 0, 0, 0], Actuation(levers(0.05, 0.05), tau_u=[-0.02, -0.02]))
    answer = solve(problem)
    assert answer.status is Status.OPTIMAL
    assert [f[2] for f in answer.forces] == pytest.approx([0.4, 0.4], rel=1e-3)


def test_joint_without_cost_does_not_enlarge_the_cost_unit():
    """The second joint has a lever arm of 1e6 and no weight: ten times the smallest torque on the first is not optimal."""
    problem = ForceProblem(pair(), [0, 0, 1.0, 0, 0, 0], Actuation(levers(0.05, 1e6), weight=[1, 0]))
    best = solve(problem)
    assert best.status is Status.OPTIMAL
    waste = best.f.copy()
    waste[[2, 5]] *= 10
    assert not certify(problem, waste, best.multipliers).verified


def test_torque_residual_is_relative_to_each_joint():
    """The first joint exceeds its limit by a tenth; a second joint with a lever arm of 1e9 does not hide that."""
    actuation = Actuation(levers(0.05, 1e9), upper=[0.05 / 1.1, None], weight=[1, 0])
    assert solve(ForceProblem(pair(), [0, 0, 1.0, 0, 0, 0], actuation), explain=False).status is not Status.OPTIMAL


@pytest.mark.parametrize("force", [1e-9, 1.0, 1e6])
@pytest.mark.parametrize("load", [0.0, 1e-9, 1e-3])
def test_largest_margin_follows_the_normal_force_limit(force, load):
    """s = μ N − w/2 for the pair, with the largest normal force N, for loads of every size."""
    w = np.array([0, 0, load * force, 0, 0, 0])
    answer = solve(ForceProblem(pair(max_normal=20.0 * force), w, objective=Objective("margin")))
    assert answer.status is Status.OPTIMAL
    assert answer.objective == pytest.approx((0.5 * 20.0 - load / 2) * force, rel=1e-7)


def test_margin_is_accurate_relative_to_the_active_limit():
    """The motors limit the normal force to 20 N; an unreachable normal-force limit does not reduce the accuracy."""
    actuation = Actuation(levers(0.05, 0.05), upper=[1.0, 1.0], lower=[-1.0, -1.0])
    w = np.array([0, 0, 2.0, 0, 0, 0])
    answer = solve(ForceProblem(pair(max_normal=1e12), w, actuation, objective=Objective("margin")))
    assert answer.status is Status.OPTIMAL
    assert answer.objective == pytest.approx(0.5 * 20.0 - 1.0, rel=1e-7)
