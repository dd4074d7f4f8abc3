"""Angles of fingers from the joint positions of hands."""

from __future__ import annotations

import numpy as np
import pytest
from support.hands import load

from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.learning import GistSettings, finger_angles, segment_finger


@pytest.mark.parametrize(("name", "finger"), [("dlr_hit2", "index"), ("allegro_right", "index"), ("four_finger", "finger_1")])
def test_bending_a_finger_increases_its_flexion_angles_alone(name, finger):
    """Each joint's own column: the flexion joints in their order from the palm, and sideways joints in the third one."""
    hand = load(name)
    joints = list(hand.finger(finger).joints)
    base = finger_angles(hand, finger, hand.neutral[None])[0]
    columns = []
    for j in joints:
        q = np.array(hand.neutral)
        towards = hand.q_upper if hand.q_upper[j] >= -hand.q_lower[j] else hand.q_lower
        q[j] = 0.5 * (q[j] + towards[j])
        change = finger_angles(hand, finger, q[None])[0] - base
        columns.append(tuple(np.flatnonzero(np.abs(change) > 1e-9).tolist()))
        assert (change[[0, 1, 3]] > -1e-12).all()
    used = [column for each in columns for column in each]
    assert 2 in used
    assert 3 in used
    assert 0 in used
    others = [j for j in range(hand.n) if j not in joints]
    q = np.array(hand.neutral)
    q[others] = 0.5 * (q[others] + hand.q_upper[others])
    np.testing.assert_allclose(finger_angles(hand, finger, q[None])[0], base, atol=1e-12)


def test_coupled_joints_move_both_of_their_angles():
    """The last two joints of a finger of DLR-HIT II turn by equal angles: columns 1 and 2."""
    hand = load("dlr_hit2")
    last = list(hand.finger("index").joints)[-1]
    q = np.array(hand.neutral)
    q[last] += 0.3
    change = finger_angles(hand, "index", q[None])[0] - finger_angles(hand, "index", hand.neutral[None])[0]
    np.testing.assert_allclose(change, [0.3, 0.3, 0.0, 0.0], atol=1e-12)


def test_opening_and_closing_of_a_hand_are_found():
    """The index finger closes for 60 frames, rests, and opens again."""
    hand = load("allegro_right")
    joints = list(hand.finger("index").joints)
    share = np.concatenate([np.zeros(50), np.linspace(0, 1, 60), np.ones(60), np.linspace(1, 0, 60), np.zeros(50)])
    q = np.tile(hand.neutral, (len(share), 1))
    q[:, joints[1:]] += share[:, None] * 0.4 * (hand.q_upper - hand.neutral)[joints[1:]]
    segments = segment_finger(finger_angles(hand, "index", q), GistSettings(deadband=0.05))
    kinds = ["rest" if each.motion == 9 else "opens" if each.motion <= 4 else "closes" for each in segments]
    assert kinds == ["rest", "closes", "rest", "opens", "rest"]
    assert [each.begin for each in segments] == pytest.approx([0, 50, 110, 170, 230], abs=3)


def test_errors_name_the_argument():
    hand = load("four_finger")
    with pytest.raises(UnknownName):
        finger_angles(hand, "pinky", hand.neutral[None])
    with pytest.raises(InvalidInput, match="q"):
        finger_angles(hand, "finger_1", hand.neutral)
