"""Workspaces: tips stay in reach of their links, and the measures are those of the Jacobian."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.hands import SHIPPED_HANDS, load

from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.hand.workspace import measure_tip, sample_workspace, sweep_joints


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_samples_stay_within_the_limits_and_move_only_the_finger(name):
    hand = load(name)
    for finger in hand.fingers:
        found = sample_workspace(hand, finger.name, samples=50, seed=3)
        assert (found.q >= hand.q_lower - 1e-12).all()
        assert (found.q <= hand.q_upper + 1e-12).all()
        others = [j for j in range(hand.n) if j not in finger.joints]
        np.testing.assert_array_equal(found.q[:, others], np.tile(hand.neutral[others], (50, 1)))
        for k in (0, 49):
            np.testing.assert_allclose(found.p_HF[k], hand.tip_pose(found.q[k], finger.name)[0], atol=1e-12)


def test_a_revolute_joint_moves_the_tip_in_a_plane():
    hand = load("four_finger")
    sweep = sweep_joints(hand, "finger_1", steps=11)
    assert [each.joint for each in sweep] == [hand.joints[j].name for j in hand.finger("finger_1").joints]
    for each in sweep:
        centre = each.tip.p_HF.mean(axis=0)
        flat = np.linalg.svd(each.tip.p_HF - centre, compute_uv=False)
        assert flat[2] < 1e-12 * max(flat[0], 1e-3)  # a circle lies in a plane


def test_measures_are_the_singular_values_of_central_differences():
    hand = load("four_finger")
    joints, step = list(hand.finger("finger_2").joints), 1e-6
    q = hand.neutral + 0.1
    found = measure_tip(hand, "finger_2", q[None])
    columns = []
    for joint in joints:
        d = step * np.eye(hand.n)[joint]
        columns.append((hand.tip_pose(q + d, "finger_2")[0] - hand.tip_pose(q - d, "finger_2")[0]) / (2 * step))
    sigma = np.linalg.svd(np.transpose(columns), compute_uv=False)
    np.testing.assert_allclose(found.min_singular_value[0], sigma[-1], rtol=1e-7)  # errors of differences: step²
    np.testing.assert_allclose(found.manipulability[0], abs(np.linalg.det(np.transpose(columns))), rtol=1e-7)


def test_hull_volume_is_that_of_a_known_body():
    hand = load("four_finger")
    tip = sample_workspace(hand, "finger_1", samples=4)
    corners = np.array([[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.2) for z in (0.0, 0.3)])
    assert math.isclose(replace(tip, p_HF=corners).hull_volume, 0.006, rel_tol=1e-12)
    assert replace(tip, p_HF=corners * [1.0, 1.0, 0.0]).hull_volume == 0.0


def test_a_jaw_has_a_line_as_its_workspace():
    hand = load("parallel_jaws")
    found = sample_workspace(hand, "left", samples=20)
    assert found.hull_volume == 0.0
    np.testing.assert_allclose(found.min_singular_value, 1.0, rtol=1e-12)  # m/m: the jaw is the tip


def test_wrong_arguments_are_named():
    hand = load("four_finger")
    with pytest.raises(UnknownName, match="finger"):
        sample_workspace(hand, "finger_9")
    with pytest.raises(InvalidInput, match="samples = 3"):
        sample_workspace(hand, "finger_1", samples=3)
    with pytest.raises(InvalidInput, match="steps = 1"):
        sweep_joints(hand, "finger_1", steps=1)
