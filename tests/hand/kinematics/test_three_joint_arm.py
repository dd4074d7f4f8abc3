"""The closed form of a three-joint finger reaches every point that the finger reaches."""

from __future__ import annotations

import numpy as np
import pytest
from support.hands import load

from graspforce.core.errors import InvalidInput
from graspforce.hand.kinematics.three_joint_arm import find_three_joint_arm

EXACT = 1e-9  # m: an arc cosine near 1 loses half of the digits of 1e-17
FINGERS = [("four_finger", "finger_1"), ("four_finger", "finger_4"), ("dclaw", "finger_1"), ("dex3_right", "thumb")]


def finger_arm(name, finger):
    """Return a hand, the joints of a finger and its arm."""
    hand = load(name)
    joints = list(hand.finger(finger).joints)

    def tip(q_finger):
        q = np.array(hand.neutral)
        q[joints] = q_finger
        p, _ = hand.tip_pose(q, finger)
        return p, hand.point_jacobian(q, finger, p)[:, joints]

    return hand, joints, tip, find_three_joint_arm(tip, (hand.q_lower[joints] + hand.q_upper[joints]) / 2.0)


@pytest.mark.parametrize(("name", "finger"), FINGERS)
def test_closed_form_reaches_the_tip_of_every_posture(name, finger):
    hand, joints, tip, arm = finger_arm(name, finger)
    lower, upper = hand.q_lower[joints], hand.q_upper[joints]
    rng = np.random.default_rng(0)
    for _ in range(100):
        p, _ = tip(lower + rng.uniform(size=3) * (upper - lower))
        postures = arm.postures(p, lower, upper)
        assert postures
        assert min(float(np.linalg.norm(tip(q)[0] - p)) for q in postures) < EXACT
        assert all((q >= lower).all() and (q <= upper).all() for q in postures)


@pytest.mark.parametrize(("name", "finger"), FINGERS)
def test_arm_has_the_kinematics_of_the_finger(name, finger):
    _, _, tip, arm = finger_arm(name, finger)
    q = np.random.default_rng(1).uniform(-1.0, 1.0, size=3)
    np.testing.assert_allclose(arm.tip(q), tip(q)[0], atol=1e-12)  # m: rounding


@pytest.mark.parametrize(("name", "finger"), [("dlr_hit2", "index"), ("allegro_right", "index"), ("barrett", "finger_1")])
def test_fingers_with_couplings_or_other_joint_counts_have_no_closed_form(name, finger):
    assert finger_arm(name, finger)[3] is None


@pytest.mark.parametrize("name", ["four_finger", "allegro_right", "dlr_hit2", "shadow_right"])
def test_tip_posture_puts_all_tips_at_their_targets(name):
    hand = load(name)
    rng = np.random.default_rng(2)
    q = hand.q_lower + rng.uniform(0.2, 0.8, size=hand.n) * (hand.q_upper - hand.q_lower)
    shared = [j for j in range(hand.n) if sum(j in finger.joints for finger in hand.fingers) > 1]
    q[shared] = hand.neutral[shared]
    tips = {finger.name: hand.tip_pose(q, finger.name)[0] for finger in hand.fingers}
    found = hand.tip_posture(tips)
    for finger, p in tips.items():
        np.testing.assert_allclose(hand.tip_pose(found, finger)[0], p, atol=1e-6)  # m: the tolerance of a reached target
    np.testing.assert_array_equal(found[shared], hand.neutral[shared])


def test_tip_posture_names_the_finger_that_cannot_reach():
    with pytest.raises(InvalidInput, match=r"tips\.finger_2.*within reach of finger_2: the nearest point found"):
        load("four_finger").tip_posture({"finger_2": [1.0, 0.0, 0.0]})
