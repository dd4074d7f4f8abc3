"""A glove as an input: the hand follows the operator's hand, the object the operator's fingertips, within their limits."""

from __future__ import annotations

import numpy as np
import pytest
from support import hands
from support.control_requests import GRASP, HAND
from support.gloves import operator_frames, operator_of, pose_frames

from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.hand.collision import HandCollision
from graspforce.learning import (
    ApproachLimits,
    FingertipMap,
    GloveApproach,
    GloveHold,
    GloveOperator,
    GloveReference,
    PostureFilter,
    RecordedFrames,
    TeleoperationLimits,
    neutral_correspondence,
)

DT = 0.002  # s
OPERATOR = operator_of(HAND)


def test_a_posture_filter_reaches_the_posture_within_its_limits():
    goal, limits = HAND.neutral + 0.3 * (HAND.q_upper - HAND.neutral), ApproachLimits(speed=1.0, acceleration=20.0)
    posture = PostureFilter(HAND, limits=limits)
    posture.command(goal)
    before = posture.motion
    for _ in range(1500):
        motion = posture.step(DT)
        assert np.abs(motion.v).max() <= 1.0 + 1e-9
        assert np.abs(motion.a).max() <= 20.0 + 1e-6
        np.testing.assert_allclose(motion.q, before.q + DT * motion.v, atol=1e-12)
        before = motion
    np.testing.assert_allclose(motion.q, goal, atol=1e-6)


def test_a_posture_beyond_the_limits_is_cut():
    posture = PostureFilter(HAND)
    posture.command(HAND.q_upper + 1.0)
    for _ in range(3000):
        motion = posture.step(DT)
        assert (motion.q <= HAND.q_upper).all()
    np.testing.assert_allclose(motion.q, HAND.q_upper, atol=1e-6)


def test_a_hand_follows_the_posture_of_its_own_glove():
    goal = HAND.neutral + 0.2 * (HAND.q_upper - HAND.neutral)
    postures = [HAND.neutral + s * (goal - HAND.neutral) for s in np.linspace(0, 1, 60)]
    frames = operator_frames(HAND, postures, noise=0.001)
    approach = GloveReference(GloveApproach(HAND, OPERATOR), RecordedFrames(frames, 60.0), DT)
    for k in range(1000):
        motion = approach(k * DT)
    errors = [HAND.tip_pose(motion.q, each.name)[0] - HAND.tip_pose(goal, each.name)[0] for each in HAND.fingers]
    assert np.linalg.norm(errors, axis=1).max() < 0.003  # m
    assert approach.taken == 60


def test_another_hand_approaches_within_limits_and_without_collisions():
    model, hand = hands.load("leap_right"), hands.load("allegro_right")
    correspondence = neutral_correspondence(model, hand, {name: name for name in ("index", "middle", "thumb")})
    approach = GloveApproach(hand, operator_of(model, correspondence))
    goal = model.neutral + 0.3 * (model.q_upper - model.neutral)
    collision = HandCollision(hand)
    for reading in operator_frames(model, [model.neutral + s * (goal - model.neutral) for s in np.linspace(0, 1, 20)]):
        approach.command(reading)
        for _ in range(8):
            motion = approach.step(DT)
        assert (motion.q >= hand.q_lower).all()
        assert (motion.q <= hand.q_upper).all()
        assert collision.link_gaps(motion.q)[0].distance >= -1e-3


def test_the_object_follows_the_fingertips_within_the_travel():
    shift = np.array([0.0, 0.001, 0.003])
    frames = pose_frames(GRASP, [s * shift for s in np.linspace(0, 1, 30)], noise=0.0)
    for travel, expected in ((0.01, shift), (0.001, 0.001 * shift / np.linalg.norm(shift))):
        hold = GloveReference(GloveHold(GRASP, OPERATOR, TeleoperationLimits(travel=travel)), RecordedFrames(frames, 60.0), DT)
        for k in range(1500):
            motion = hold(k * DT)
            assert np.linalg.norm(motion.p_HO - GRASP.p_HO) <= travel + 1e-4
        np.testing.assert_allclose(motion.p_HO - GRASP.p_HO, expected, atol=4e-4)
        np.testing.assert_allclose(motion.R_HO, GRASP.R_HO, atol=1e-12)  # `turn` is 0


def test_the_first_frame_moves_nothing():
    """The operator may begin in any posture."""
    frames = operator_frames(HAND, [HAND.neutral] * 5, noise=0.0)
    hold = GloveReference(GloveHold(GRASP, OPERATOR), RecordedFrames(frames, 60.0), DT)
    for k in range(100):
        motion = hold(k * DT)
    np.testing.assert_allclose(motion.p_HO, GRASP.p_HO, atol=1e-12)


def test_invalid_arguments_are_refused():
    two = FingertipMap({name: name for name in GRASP.fingers[:2]})
    for error, call in (
        (InvalidInput, lambda: GloveOperator(OPERATOR.calibration, hands.load("leap_right"), two)),
        (UnknownName, lambda: GloveOperator(OPERATOR.calibration, HAND, FingertipMap({GRASP.fingers[0]: "tail"}))),
        (InvalidInput, lambda: GloveHold(GRASP, GloveOperator(OPERATOR.calibration, HAND, two))),
        (InvalidInput, lambda: GloveHold(GRASP, OPERATOR, gain=0.0)),
        (InvalidInput, lambda: GloveHold(GRASP, OPERATOR).command([1.0])),
        (InvalidInput, lambda: ApproachLimits(speed=0.0)),
        (InvalidInput, lambda: PostureFilter(HAND).step(0.2)),
        (InvalidInput, lambda: PostureFilter(HAND).command([0.0])),
        (InvalidInput, lambda: GloveReference(GloveHold(GRASP, OPERATOR), RecordedFrames([[0.0]], 60.0), 0.0)),
        (InvalidInput, lambda: RecordedFrames(np.zeros((0, 2)), 60.0)),
    ):
        with pytest.raises(error):
            call()
