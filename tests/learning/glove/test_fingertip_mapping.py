"""Mapping of fingertips: reachable targets are reached, limits and clearance always kept."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import hands

from graspforce.core.errors import InvalidInput
from graspforce.hand.collision import HandCollision
from graspforce.learning import FingertipMap, FingertipMapper, fit_fingertip_map

SAME = {name: name for name in ("index", "middle", "ring", "thumb")}


def tips(hand, q):
    return {finger.name: hand.tip_pose(q, finger.name)[0] for finger in hand.fingers}


def stream(hand, frames=25):
    """Fingertips of the hand on its way from neutral to a posture 30 % towards the upper limits."""
    goal = hand.neutral + 0.3 * (hand.q_upper - hand.neutral)
    return [tips(hand, hand.neutral + s * (goal - hand.neutral)) for s in np.linspace(0.0, 1.0, frames)]


def test_a_hand_follows_its_own_fingertips():
    hand = hands.load("leap_right")
    mapper = FingertipMapper(hand, FingertipMap(SAME, smoothing=1e-4))
    for frame in stream(hand):
        posture = mapper.step(frame)
        assert posture.is_held_back or max(posture.errors.values()) < 1e-4


def test_scale_and_frame_are_applied():
    """A source of half the size, turned by 90° about z and shifted, has the same targets."""
    hand = hands.load("leap_right")
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([0.01, -0.02, 0.03])
    source = {name: R.T @ (p - shift) / 2.0 for name, p in tips(hand, hand.neutral).items()}
    targets = FingertipMap(SAME, scale=2.0, R_HS=R, p_HS=shift).targets(source)
    for name, p in tips(hand, hand.neutral).items():
        np.testing.assert_allclose(targets[name], p, atol=1e-12)


def test_a_fitted_map_recovers_scale_rotation_and_place():
    rng = np.random.default_rng(0)
    R, p, x = Rotation.random(random_state=1).as_matrix(), [0.1, 0.2, 0.3], 0.05 * rng.normal(size=(12, 3))
    found = fit_fingertip_map(SAME, x, 1.3 * x @ R.T + p)
    assert found.scale == pytest.approx(1.3)
    np.testing.assert_allclose(found.R_HS, R, atol=1e-9)
    np.testing.assert_allclose(found.p_HS, p, atol=1e-9)


def test_another_hand_follows_within_its_limits_and_without_collisions():
    """Fingertips of the LEAP hand drive the Allegro hand, which is 20 % larger in this mapping."""
    source, hand = hands.load("leap_right"), hands.load("allegro_right")
    start = np.mean([hand.tip_pose(hand.neutral, name)[0] for name in SAME], axis=0)
    middle = np.mean([source.tip_pose(source.neutral, name)[0] for name in SAME], axis=0)
    mapper = FingertipMapper(hand, FingertipMap(SAME, scale=1.2, p_HS=start - 1.2 * middle))
    collision = HandCollision(hand)
    for frame in stream(source):
        q = mapper.step(frame).q
        assert (q >= hand.q_lower).all()
        assert (q <= hand.q_upper).all()
        assert collision.link_gaps(q)[0].distance >= 0.0


def test_targets_that_collide_hold_the_hand_back():
    hand = hands.load("leap_right")
    mapper = FingertipMapper(hand, FingertipMap({"index": "a", "middle": "b"}, clearance=0.002))
    together = hand.tip_pose(hand.neutral, "middle")[0]
    results = [mapper.step({"a": together, "b": together}) for _ in range(5)]
    assert any(each.is_held_back for each in results)
    assert HandCollision(hand).link_gaps(mapper.q)[0].distance >= 0.002


def test_an_unreachable_target_is_approached():
    hand = hands.load("leap_right")
    mapper = FingertipMapper(hand, FingertipMap({"index": "index"}))
    p = hand.tip_pose(hand.neutral, "index")[0]
    far = p + 0.3 * p / np.linalg.norm(p)
    error = mapper.step({"index": far}).errors["index"]
    assert 0.0 < error < np.linalg.norm(far - p)


def test_invalid_arguments_are_refused():
    hand = hands.load("leap_right")
    for call in (
        lambda: FingertipMap({}),
        lambda: fit_fingertip_map(SAME, np.zeros((4, 3)), np.zeros((4, 3))),
        lambda: FingertipMap(SAME, scale=0.0),
        lambda: FingertipMap(SAME, R_HS=np.ones((3, 3))),
        lambda: FingertipMapper(hand, FingertipMap({"tail": "index"})),
        lambda: FingertipMapper(hand, FingertipMap(SAME, clearance=1.0)),
        lambda: FingertipMapper(hand, FingertipMap(SAME)).step({"index": np.zeros(3)}),
    ):
        with pytest.raises(InvalidInput):
            call()
