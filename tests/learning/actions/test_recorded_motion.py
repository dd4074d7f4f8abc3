"""Motions of recorded objects for other objects."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce.contact.motion import BodyMotion
from graspforce.core.errors import InvalidInput
from graspforce.geometry.rotations import rotation_exp
from graspforce.learning import recorded_motion
from graspforce.planning.regrasp.pose_path import PosePath

S = np.linspace(0.0, 1.0, 1000)
P = np.column_stack([0.1 + 0.02 * S, 0.01 * np.sin(np.pi * S), 0.05 + 0.0 * S])
R = np.array([rotation_exp([0.0, 0.0, 0.8 * s]) @ rotation_exp([0.3, 0.0, 0.0]) for s in S])


def test_equal_start_and_size_give_the_recorded_poses():
    motion = recorded_motion(P, R, BodyMotion(P[0], R[0]))
    for p, axes in zip(*motion, strict=True):
        k = int(np.linalg.norm(P - p, axis=1).argmin())
        np.testing.assert_allclose(p, P[k], atol=1e-15)
        np.testing.assert_allclose(axes, R[k], atol=1e-12)
    assert len(motion.p_HO) < len(P)


def test_larger_object_moves_farther_and_turns_equally():
    start = BodyMotion([0.0, 0.2, 0.1], rotation_exp([0.0, 1.0, 0.0]))
    motion, same = recorded_motion(P, R, start, 1.5), recorded_motion(P, R, start)
    np.testing.assert_allclose(motion.p_HO[-1] - start.p_HO, 1.5 * (P[-1] - P[0]), atol=2e-4)  # the last poses may be left out
    np.testing.assert_allclose(motion.R_HO[0], start.R_HO, atol=1e-12)
    turn = motion.R_HO[-1] @ start.R_HO.T
    np.testing.assert_allclose(turn, same.R_HO[-1] @ start.R_HO.T, atol=5e-3)


def test_fingertips_on_the_larger_object_move_in_proportion():
    """Two contacts on opposite sides: their relative motions scale with the object."""
    start = BodyMotion(P[0], R[0])
    motion = recorded_motion(P, R, start, 2.0)
    recorded = recorded_motion(P, R, start, 1.0)
    arm = np.array([0.03, 0.0, 0.0])  # m, from O to a contact of the recorded object
    moved = motion.p_HO + motion.R_HO @ (2.0 * arm)
    small = recorded.p_HO + recorded.R_HO @ arm
    np.testing.assert_allclose(moved[-1] - moved[0], 2.0 * (small[-1] - small[0]), atol=5e-4)


def test_the_poses_are_a_path_for_planners():
    motion = recorded_motion(P, R, BodyMotion(P[0], R[0]))
    path = PosePath(motion.p_HO, motion.R_HO)
    assert path.knots[-1] > 0.0


def test_object_at_rest_is_refused():
    with pytest.raises(InvalidInput, match="p_HO"):
        recorded_motion(np.tile(P[0], (50, 1)), np.tile(R[0], (50, 1, 1)), BodyMotion(P[0], R[0]))
