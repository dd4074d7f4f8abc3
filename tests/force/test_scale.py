"""The units of a problem follow its own, whatever O, and no answer passes because one of them was too large or too small."""

from __future__ import annotations

import numpy as np
import pytest
from support.random_problems import random_problem

from graspforce import Actuation, Contact, ForceProblem, Multipliers, Objective, Status, solve
from graspforce.force.certificate import certify, certify_infeasibility
from graspforce.force.scale import scale


def pair(**changes) -> list[Contact]:
    """Two contacts 10 cm apart on the y axis, pressing towards each other."""
    given = {"friction": 0.5, **changes}
    return [Contact([0, y, 0], [0, -np.sign(y), 0], **given) for y in (-0.05, 0.05)]


def levers(*each: float) -> np.ndarray:
    """Return a joint for each of the pair's normal forces."""
    J = np.zeros((6, len(each)))
    for j, lever in enumerate(each):
        J[2 + 3 * j, j] = lever
    return J


def moved(problem: ForceProblem, origin: np.ndarray) -> ForceProblem:
    """Return the same problem with O at ``origin``: positions and the wrench's moment change, the physics does not."""
    p = problem.contacts.p_OC - origin
    w = np.append(problem.w[:3], problem.w[3:] - np.cross(origin, problem.w[:3]))
    return problem.replace(p=p, w=w)


@pytest.mark.parametrize("distance", [1.0, 1e2, 1e4])
@pytest.mark.parametrize("seed", range(10))
def test_it_does_not_matter_where_O_stands(seed, distance):
    rng = np.random.default_rng([31, seed])
    near = random_problem(rng)
    far = moved(near, distance * rng.normal(size=3))
    # A position keeps 16 digits: 1e4 m leave 1e-12 m of it, 1e-10 of a small grasp, and that much of the moment's unit.
    lost = 1e-12 + 1e-13 * distance  # relative
    one, other = scale(near), scale(far)
    for unit in ("force", "length", "torque", "cost"):
        assert getattr(other, unit) == pytest.approx(getattr(one, unit), rel=lost)
    here, there = solve(near, explain=False), solve(far, explain=False)
    assert there.status is here.status
    if here.found:
        assert there.objective == pytest.approx(here.objective, rel=1e-6, abs=1e-6 * one.cost)


def test_the_nearest_wrench_moves_with_O():
    """2 μ N = 5 N can be lifted of 8 N, wherever the moment is taken about."""
    near = ForceProblem(pair(friction=0.25, max_normal=10.0), [0, 0, 8.0, 0, 0, 0])
    origin = np.array([30.0, -20.0, 10.0])
    held = moved(near.replace(w=[0, 0, 5.0, 0, 0, 0]), origin).w
    assert solve(moved(near, origin)).infeasibility.nearest_wrench == pytest.approx(held, abs=1e-6)


@pytest.mark.parametrize("load", [1e-3, 1e-9, 0.0])
@pytest.mark.parametrize("least", [1.0, 1e4])
def test_a_joint_that_must_press_hard_under_a_small_load_is_held(load, least):
    """tau ≥ least on levers of 5 cm needs 20 N a newton metre, and the pair has it: nobody limits the normal forces."""
    actuation = Actuation(levers(0.05, 0.05), lower=[least, least])
    problem = ForceProblem(pair(), [0, 0, load, 0, 0, 0], actuation)
    answer = solve(problem)
    assert answer.status is Status.OPTIMAL
    assert answer.torques == pytest.approx([least, least], rel=1e-7)
    nothing = np.zeros(2)
    both = Multipliers(np.zeros(6), nothing, nothing, np.ones(2), nothing, nothing)
    assert not certify_infeasibility(problem, both).certificate.verified


@pytest.mark.parametrize("mu", [1e-3, 1e-5, 1e-7, 1e-9])
def test_smooth_contacts_that_would_hold_if_pressed_hard_enough_are_not_refuted(mu):
    """f_n = w/(2μ) holds; y = e_z with the friction left out of the account must not prove otherwise."""
    problem = ForceProblem(pair(friction=mu), [0, 0, 1.0, 0, 0, 0])
    nothing, none = np.zeros(2), np.zeros(0)
    lift = Multipliers(np.array([0, 0, 1.0, 0, 0, 0]), nothing, nothing, none, none, nothing)
    assert not certify_infeasibility(problem, lift).certificate.verified
    assert solve(problem, explain=False).status is not Status.INFEASIBLE


@pytest.mark.parametrize("load", [1e-3, 1e-6, 1e-9])
def test_bias_torques_under_a_small_load_are_cancelled(load):
    """f_n = −tau_u/lever takes both torques to zero, which a load of milligrams does not change."""
    problem = ForceProblem(pair(), [0, 0, load, 0, 0, 0], Actuation(levers(0.05, 0.05), tau_u=[-0.02, -0.02]))
    answer = solve(problem)
    assert answer.status is Status.OPTIMAL
    assert [f[2] for f in answer.forces] == pytest.approx([0.4, 0.4], rel=1e-3)


def test_a_joint_that_costs_nothing_does_not_make_waste_cheap():
    """The second joint has a lever of 1e6 and no weight: ten times the least torque on the first is still no optimum."""
    problem = ForceProblem(pair(), [0, 0, 1.0, 0, 0, 0], Actuation(levers(0.05, 1e6), weight=[1, 0]))
    best = solve(problem)
    assert best.status is Status.OPTIMAL
    waste = best.f.copy()
    waste[[2, 5]] *= 10
    assert not certify(problem, waste, best.multipliers).verified


def test_each_joint_is_held_to_its_own_limit():
    """A second joint with a lever of 1e9 is no excuse for the first to exceed its limit by a tenth."""
    actuation = Actuation(levers(0.05, 1e9), upper=[0.05 / 1.1, None], weight=[1, 0])
    assert solve(ForceProblem(pair(), [0, 0, 1.0, 0, 0, 0], actuation), explain=False).status is not Status.OPTIMAL


@pytest.mark.parametrize("force", [1e-9, 1.0, 1e6])
@pytest.mark.parametrize("load", [0.0, 1e-9, 1e-3])
def test_the_margin_of_a_squeeze_follows_its_limit_not_its_load(force, load):
    """s = μ N − w/2 for the pair, N being the largest normal force, whatever the load is beside it."""
    w = np.array([0, 0, load * force, 0, 0, 0])
    answer = solve(ForceProblem(pair(max_normal=20.0 * force), w, objective=Objective("margin")))
    assert answer.status is Status.OPTIMAL
    assert answer.objective == pytest.approx((0.5 * 20.0 - load / 2) * force, rel=1e-7)


def test_the_margin_is_as_exact_as_the_limit_that_ends_it():
    """The motors end the squeeze at 20 N; a normal-force limit that nobody can reach does not make the answer coarse."""
    actuation = Actuation(levers(0.05, 0.05), upper=[1.0, 1.0], lower=[-1.0, -1.0])
    w = np.array([0, 0, 2.0, 0, 0, 0])
    answer = solve(ForceProblem(pair(max_normal=1e12), w, actuation, objective=Objective("margin")))
    assert answer.status is Status.OPTIMAL
    assert answer.objective == pytest.approx(0.5 * 20.0 - 1.0, rel=1e-7)
