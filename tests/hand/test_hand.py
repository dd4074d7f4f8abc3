"""Hands: the shipped ones, their record and their table."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.hands import SHIPPED_HANDS, load

from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.hand.descriptions.description import shipped_hands

# ── shipped hands ──────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_shipped_hands_have_these_joints_and_fingers() -> None:
    joints_and_fingers = {
        "ability_right": (6, 5),
        "anthropomorphic15": (15, 5),
        "barrett": (4, 3),
        "dclaw": (9, 3),
        "dex3_right": (7, 3),
        "dlr_hit2": (15, 5),
        "four_finger": (12, 4),
        "leap_right": (16, 4),
        "parallel_jaws": (1, 2),
        "shadow_right": (20, 5),
    }
    assert shipped_hands() == tuple(sorted({"allegro_left", "allegro_right", *joints_and_fingers}))
    assert {name: (load(name).n, len(load(name).fingers)) for name in joints_and_fingers} == joints_and_fingers


@pytest.mark.parametrize("side", ["allegro_left", "allegro_right"])
def test_allegro_hands_have_sixteen_motors_of_0_7_newton_metres(side: str) -> None:
    hand = load(side)
    assert hand.n == 16
    assert [finger.name for finger in hand.fingers] == ["index", "middle", "ring", "thumb"]
    np.testing.assert_array_equal(hand.torque_upper, 0.7)


def test_allegro_hands_are_mirror_images() -> None:
    """Equal postures are reflected in the plane y = 0, with opposite spreading joints."""
    left, right = load("allegro_left"), load("allegro_right")
    q = np.array(right.neutral)
    spreading = [right.joints[right.finger(name).joints[0]].name for name in ("index", "middle", "ring")]
    for finger in right.fingers:
        q_right, q_left = q.copy(), q.copy()
        for name in spreading:
            i = [joint.name for joint in right.joints].index(name)
            q_right[i], q_left[i] = 0.2, -0.2
        p_right, p_left = right.tip_pose(q_right, finger.name)[0], left.tip_pose(q_left, finger.name)[0]
        np.testing.assert_allclose(p_left, p_right * [1, -1, 1], atol=1e-9)  # the URDFs have ten digits


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_arrays_of_a_hand_are_those_of_its_joints_and_read_only(name: str) -> None:
    hand = load(name)
    assert hand.T.shape == (len(hand.full_joints), hand.n)
    for field, values in (
        ("lower", hand.q_lower),
        ("upper", hand.q_upper),
        ("torque", hand.torque_upper),
        ("velocity", hand.velocity_limit),
        ("rotor_inertia", hand.rotor_inertia),
    ):
        expected = [getattr(joint, field) for joint in hand.joints]
        if field == "torque":  # at most the threshold of a closed breakaway
            thresholds = {each.joints[0]: each.threshold or np.inf for each in hand.tendons}
            expected = np.minimum(expected, [thresholds.get(name, np.inf) for name in hand.joint_names])
        np.testing.assert_array_equal(values, expected)
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1.0
    assert (hand.neutral >= hand.q_lower).all()
    assert (hand.neutral <= hand.q_upper).all()
    assert (hand.rotor_inertia > 0).all()
    assert sorted({i for finger in hand.fingers for i in finger.joints}) == list(range(hand.n))


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_description_is_a_json_record_with_a_source_for_every_joint(name: str) -> None:
    hand = load(name)
    described = json.loads(json.dumps(hand.describe()))
    assert described == hand.describe()
    assert [joint["name"] for joint in described["joints"]] == [joint.name for joint in hand.joints]
    assert all(joint["source"] for joint in described["joints"])
    assert {f["name"]: f["joints"] for f in described["fingers"]} == {
        finger.name: [hand.joints[i].name for i in finger.joints] for finger in hand.fingers
    }


def test_dlr_hit2_has_the_limits_and_masses_of_the_study() -> None:
    hand = load("dlr_hit2")
    np.testing.assert_allclose(np.rad2deg(hand.q_lower).reshape(5, 3), np.tile([-20, 0, 0], (5, 1)), atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(hand.q_upper).reshape(5, 3), np.tile([20, 90, 90], (5, 1)), atol=1e-9)
    moving = hand.describe()["moving_masses"]
    assert [moving[f"index_joint_{k}"] for k in (2, 3, 4)] == pytest.approx([0.061, 0.025, 0.024])
    assert set(hand.torque_upper) == {0.5}


def test_error_for_an_unknown_finger_lists_the_fingers() -> None:
    with pytest.raises(UnknownName, match="finger_1, finger_2, finger_3, finger_4"):
        load("four_finger").finger("thumb")
    assert issubclass(UnknownName, InvalidInput)


# ── the record and the table ───────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_description_gives_the_pose_of_every_frame(name: str) -> None:
    """At the neutral posture and at another."""
    hand = load(name)
    other = 0.3 * hand.q_lower + 0.7 * hand.q_upper
    for q, record in ((hand.neutral, hand.describe()), (other, hand.describe(other))):
        assert record["posture"] == list(q)
        frames = {frame["name"]: frame for frame in record["frames"]}
        assert len(frames) == len(record["frames"])
        assert frames[record["base"]]["position"] == [0.0, 0.0, 0.0]
        for finger in hand.fingers:
            p, R = hand.tip_pose(q, finger.name)
            frame = frames[finger.tip]
            assert finger.name in frame["tip_of"]
            np.testing.assert_array_equal(frame["position"], p)
            np.testing.assert_array_equal(frame["rotation"], R)
        assert sum(len(frame["tip_of"]) for frame in record["frames"]) == len(hand.fingers)
        assert set(frames) == set(hand.link_poses(q))
    with pytest.raises(InvalidInput, match=rf"q = .*: must be a list of {hand.n} numbers"):
        hand.describe([0.0] * (hand.n + 1))


def test_printed_hand_is_a_table_of_its_joints() -> None:
    hand = load("dlr_hit2")
    lines = str(hand).splitlines()
    assert lines[0] == "dlr_hit2: DLR-HIT II: five equal fingers, 15 motors, 20 joints"
    assert len(lines) == 2 + hand.n
    assert lines[2].split() == ["thumb", "thumb_joint_1", "-0.3491", "0.3491", "3", "0.5"]
    assert hand._repr_html_().count("<tr>") == 1 + hand.n


def test_derated_hand_has_a_fraction_of_the_torques() -> None:
    hand = load("four_finger")
    np.testing.assert_allclose(hand.derated(0.9).torque_upper, 0.9 * hand.torque_upper)
    with pytest.raises(InvalidInput, match=r"torque_fraction = 0\.0"):
        hand.derated(0.0)


def test_tip_offset_displaces_tips_in_their_axes_and_nothing_else() -> None:
    hand, offset = load("allegro_right"), np.array([1e-3, -2e-3, 3e-3])  # m
    displaced = hand.with_tip_offsets({"index": offset})
    rng = np.random.default_rng(0)
    q, v = rng.uniform(hand.q_lower, hand.q_upper), rng.normal(size=hand.n)
    p, R = hand.tip_pose(q, "index")
    p_displaced, R_displaced = displaced.tip_pose(q, "index")
    np.testing.assert_allclose(p_displaced - p, R @ offset, atol=1e-15)
    np.testing.assert_array_equal(R_displaced, R)
    for finger in ("middle", "thumb"):
        np.testing.assert_array_equal(displaced.tip_pose(q, finger)[0], hand.tip_pose(q, finger)[0])
    np.testing.assert_array_equal(displaced.mass_matrix(q), hand.mass_matrix(q))
    np.testing.assert_array_equal(hand.tip_pose(q, "index")[0], p)  # the first hand is unchanged
    twist, moved = (each.tip_motion(q, v, ["index"]).twist[0] for each in (hand, displaced))
    np.testing.assert_allclose(moved[:3] - twist[:3], np.cross(twist[3:], R @ offset), atol=1e-12)
    tip = next(tip for tip in displaced.tree().tips if tip.finger == "index")
    undisplaced = next(tip for tip in hand.tree().tips if tip.finger == "index")
    np.testing.assert_allclose(tip.p_LF - undisplaced.p_LF, tip.R_LF @ offset, atol=1e-15)
    with pytest.raises(UnknownName, match="pinky"):
        hand.with_tip_offsets({"pinky": offset})
    with pytest.raises(InvalidInput, match=r"offsets\.index\[0\]"):
        hand.with_tip_offsets({"index": [np.nan, 0.0, 0.0]})
