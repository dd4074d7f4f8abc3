"""Collision geometry of a scene: nearest pairs in one posture and along a motion."""

from __future__ import annotations

import numpy as np
import pytest
from support.hands import SHIPPED_HANDS, load, random_posture

from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Shape, Sphere, Superquadric
from graspforce.geometry.rotations import rotation_exp
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.grasp.collision.settings import CollisionSettings
from graspforce.hand.collision import HandCollision

AXES = np.eye(3)


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_least_distance_in_a_posture_is_that_of_all_pairs(name: str) -> None:
    """The bounds never hide the nearest pair: against the distances of every pair."""
    hand = load(name)
    scene, pairs = SceneCollision(hand), HandCollision(hand)
    for seed in range(4):
        q = random_posture(hand, seed)
        nearest, gap = pairs.link_gaps(q)[0], scene.least_gap(q)
        assert gap is not None
        assert gap.distance <= nearest.distance + max(1e-5, 0.02 * nearest.distance)  # the search's tolerance
        assert gap.distance >= nearest.distance - 1e-9


@pytest.mark.parametrize("shape", [Sphere(0.02), Cylinder(0.015, 0.05), Box([0.03, 0.04, 0.05])], ids=["ball", "can", "box"])
def test_least_distance_along_a_motion_is_that_of_all_instants(shape: Shape) -> None:
    """A turning object passes a moving hand; every pair at every instant is the reference."""
    hand = load("four_finger")
    pairs, scene = HandCollision(hand), SceneCollision(hand, shape)
    u = np.linspace(0.0, 1.0, 60)[:, None]
    q = (1.0 - u) * random_posture(hand, 1) + u * random_posture(hand, 2)
    p = (1.0 - u) * np.array([0.0, -0.1, 0.15]) + u * np.array([0.02, 0.1, 0.2])
    R = np.array([rotation_exp(2.0 * x * np.array([1.0, 0.5, 0.2])) for x in u.ravel()])
    every = [
        min(pairs.link_gaps(q[k])[0].distance, pairs.object_gaps(q[k], shape, p[k], R[k])[0].distance) for k in range(len(q))
    ]
    along = scene.least_gap_along(q, p, R)
    assert along is not None
    assert along.gap.distance == pytest.approx(min(every), abs=max(1e-5, 0.02 * abs(min(every))))
    assert every[along.instant] == pytest.approx(along.gap.distance, abs=1e-9)


def test_nearest_points_are_the_distance_apart() -> None:
    hand = load("four_finger")
    scene = SceneCollision(hand, Sphere(0.01))
    gap = scene.least_gap(hand.neutral, np.array([0.0, 0.0, 0.06]), AXES)
    assert gap is not None
    assert gap.second == "object"
    assert gap.distance == pytest.approx(float(np.linalg.norm(gap.points[1] - gap.points[0])), abs=1e-7)
    assert np.linalg.norm(gap.points[1] - [0.0, 0.0, 0.06]) == pytest.approx(0.01, abs=1e-7)


def test_links_of_contact_tips_may_touch_the_object_and_others_not() -> None:
    hand = load("four_finger")
    free, touching = SceneCollision(hand, Sphere(0.02)), SceneCollision(hand, Sphere(0.02), ["finger_1"])
    tip, p = hand.finger("finger_1").tip, hand.tip_pose(hand.neutral, "finger_1")[0]
    gap = free.least_gap(hand.neutral, p, AXES)
    assert gap is not None
    assert gap.distance < 0.0
    names = {touching.names(pair) for pair in range(len(touching.pairs))}
    assert (tip, "object") not in names
    assert (hand.finger("finger_2").tip, "object") in names
    assert ("palm", "object") in names


def test_obstacles_are_named_and_keep_away_from_links_and_object_alike() -> None:
    hand = load("four_finger")
    wall = Obstacle(Box([0.01, 0.2, 0.2]), [0.3, 0.0, 0.1])
    scene = SceneCollision(hand, Sphere(0.02), settings=CollisionSettings(obstacles=[wall]))
    gap = scene.least_gap(hand.neutral, np.array([0.27, 0.0, 0.1]), AXES)
    assert gap is not None
    assert (gap.first, gap.second) == ("object", "obstacles[0]")
    assert gap.distance == pytest.approx(0.3 - 0.005 - 0.27 - 0.02, abs=1e-6)
    base = {body.name for body in scene.bodies if body.frame == -1}
    assert not any(set(scene.names(pair)) <= base for pair in range(len(scene.pairs)) if "obstacles[0]" in scene.names(pair))


def test_margin_is_lowered_to_the_distance_at_the_ends() -> None:
    """At both ends the ball is 1 mm from the wall: 1 mm is required although the margin is 5 mm."""
    hand = load("four_finger")
    wall = Obstacle(Box([0.01, 0.5, 0.5]), [0.4, 0.0, 0.1])
    scene = SceneCollision(hand, Sphere(0.02), settings=CollisionSettings(0.005, [wall]))
    p = np.array([[0.374, y, 0.1] for y in (0.0, 0.01, 0.02)])
    kept = scene.least_gap_along(np.tile(hand.neutral, (3, 1)), p, np.tile(AXES, (3, 1, 1)))
    assert kept is not None
    assert kept.lack == pytest.approx(0.0, abs=1e-6)
    p[1, 0] += 0.0005
    closer = scene.least_gap_along(np.tile(hand.neutral, (3, 1)), p, np.tile(AXES, (3, 1, 1)))
    assert closer is not None
    assert (closer.instant, closer.lack) == (1, pytest.approx(0.0005, abs=1e-6))


def test_ellipsoid_has_the_distance_of_its_axes() -> None:
    """Its hull of surface points is inside the surface by less than 0.2 % of its size."""
    hand = load("four_finger")
    wall = Obstacle(Box([0.01, 0.5, 0.5]), [0.4, 0.0, 0.1])
    scene = SceneCollision(hand, Superquadric([0.03, 0.02, 0.01], [1.0, 1.0]), settings=CollisionSettings(obstacles=[wall]))
    x: Array = np.array([0.36, 0.0, 0.1])
    gap = scene.least_gap(hand.neutral, x, AXES)
    assert gap is not None
    assert gap.distance == pytest.approx(0.005, abs=6e-5)


def test_obstacles_of_another_type_are_rejected() -> None:
    with pytest.raises(InvalidInput, match="obstacles"):
        CollisionSettings(obstacles=[Sphere(0.1)])  # type: ignore[list-item]
