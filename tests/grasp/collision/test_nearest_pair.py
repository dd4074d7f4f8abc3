"""The nearest pair in one posture, against the distances of all pairs."""

from __future__ import annotations

import numpy as np
import pytest
from support.hands import SHIPPED_HANDS, load, random_posture

from graspforce.geometry import Box, Cylinder, Shape, Sphere, Superquadric
from graspforce.geometry.rotations import rotation_exp
from graspforce.grasp.collision.nearest_pair import NearestPair
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.hand.collision import HandCollision

SHAPES: list[Shape] = [
    Sphere(0.02),
    Cylinder(0.015, 0.05),
    Box([0.03, 0.04, 0.05]),
    Superquadric((0.02, 0.02, 0.03), (0.5, 1.0)),
]


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_nearest_pair_is_that_of_all_pairs(name: str) -> None:
    """The bounds never hide the nearest pair, separate or overlapping."""
    hand, rng = load(name), np.random.default_rng(0)
    pairs = HandCollision(hand)
    for i, shape in enumerate(SHAPES):
        nearest = NearestPair(hand, SceneCollision(hand, shape))
        q = random_posture(hand, i)
        p, R = rng.uniform([-0.05, -0.05, 0.0], [0.05, 0.05, 0.2]), rotation_exp(rng.normal(size=3))
        every = min(pairs.link_gaps(q)[0].distance, pairs.object_gaps(q, shape, p, R)[0].distance)
        gap = nearest.find(q, p, R)
        assert gap is not None
        assert gap.distance == pytest.approx(every, abs=1e-9)


def test_approaching_object_changes_the_distance_by_its_travel() -> None:
    """A ball moves towards the palm's box along the nearest points: the distance shrinks by the travel, below zero."""
    hand, ball = load("four_finger"), Sphere(0.005)
    nearest = NearestPair(hand, SceneCollision(hand, ball))
    start = np.array([0.0, 0.0, 0.03])
    first = nearest.find(hand.neutral, start, np.eye(3))
    assert first is not None
    towards = (first.points[0] - first.points[1]) / first.distance
    for travel in (0.25 * first.distance, 0.5 * first.distance, first.distance + 1e-3):
        gap = nearest.find(hand.neutral, start + travel * towards, np.eye(3))
        assert gap is not None
        assert gap.distance == pytest.approx(first.distance - travel, abs=1e-6)  # coal's tolerance
        assert {gap.first, gap.second} == {first.first, "object"}
