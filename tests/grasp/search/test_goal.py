"""Residuals of the grasp search: the evaluation near one candidate equals that of any candidates."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce.core.arrays import freeze
from graspforce.geometry import Box, Solid, Superquadric
from graspforce.grasp.search.batch_kinematics import BatchKinematics
from graspforce.grasp.search.candidates import Candidates, GeometryRequirements
from graspforce.grasp.search.goal import SearchGoal, hull_points
from graspforce.grasp.search.sampling import sample_candidates
from graspforce.hand.hand import Hand

STEP = 1e-7  # rad and m


@pytest.mark.parametrize("shape", [Box((0.04, 0.05, 0.06)), Superquadric((0.02, 0.03, 0.04), (1.0, 1.0))])
def test_evaluation_near_one_candidate_equals_that_of_any_candidates(shape: Solid) -> None:
    hand = Hand.load("allegro_right")
    requirements = GeometryRequirements(0.002, 0.4, freeze(np.eye(3)[0]), freeze(np.zeros(3)), 0.005)
    goal = SearchGoal(hand, BatchKinematics(hand), shape, (0, 1, 3), requirements, hull_points(shape))
    some = sample_candidates(goal, np.random.default_rng(0))
    costs = np.square(goal.residuals(some, 1.0, goal.rough_faces)).sum(axis=1)
    for b in costs.argsort()[:5]:
        x = np.vstack([some.x[b], some.x[b] + STEP * np.eye(some.x.shape[1])])
        near = Candidates(x, np.repeat(some.R_start[[b]], len(x), axis=0), np.repeat(some.face[[b]], len(x), axis=0))
        exact, found = goal.residuals(near), goal.residuals(near, faces_at=goal.faces_near_first)
        np.testing.assert_allclose(found, exact, rtol=0.0, atol=1e-7)  # of slopes up to 1e3 per step, and their change


def test_distances_of_pairs_near_one_candidate_are_exact_to_first_order() -> None:
    hand = Hand.load("leap_right")
    requirements = GeometryRequirements(0.002, 0.4, freeze(np.eye(3)[0]), freeze(np.zeros(3)), 0.005)
    goal = SearchGoal(hand, BatchKinematics(hand), Box((0.04, 0.05, 0.06)), (0, 1, 3), requirements)
    goal = goal.with_pairs(goal.forbidden_pairs.pairs)
    some = sample_candidates(goal, np.random.default_rng(0))
    x = np.vstack([some.x[0], some.x[0] + STEP * np.eye(some.x.shape[1])])
    near = Candidates(x, np.repeat(some.R_start[[0]], len(x), axis=0), np.repeat(some.face[[0]], len(x), axis=0))
    exact, found = goal.measure(near).pair_distance, goal.measure(near, goal.faces_near_first).pair_distance
    moved = np.abs(exact - exact[0])
    assert exact.shape == (len(x), len(goal.forbidden_pairs.pairs))
    assert moved.max() > 0.3 * STEP  # m: levers are up to 0.3 m
    np.testing.assert_allclose(found, exact, rtol=0.0, atol=0.05 * STEP)
