"""Motions of the object that the fingers can and cannot follow."""

from __future__ import annotations

import numpy as np
import pytest
from support.control_grasps import named_grasp

from graspforce.cli import main
from graspforce.contact.motion import BodyMotion
from graspforce.simulation import constant_reference, linear_reference, rotation_reference
from graspforce.simulation.loops.reach import find_unreachable

GRASPS = ["four_finger box", "allegro_right sphere", "dlr_hit2 sphere"]


@pytest.fixture(params=GRASPS)
def grasp(request):
    return named_grasp(request.param)


def test_small_motions_are_within_reach(grasp):
    start = BodyMotion(grasp.p_HO, grasp.R_HO)
    assert find_unreachable(grasp, constant_reference(start), 1.0) is None
    assert find_unreachable(grasp, linear_reference(start, np.array([0.0, 0.0, 5e-3]), 1.0), 1.0) is None
    assert find_unreachable(grasp, rotation_reference(start, np.array([0.0, 0.0, 1.0]), 0.1, 1.0), 1.0) is None


def test_motions_beyond_the_fingers_are_found(grasp):
    """0.5 m are more than any finger is long."""
    start = BodyMotion(grasp.p_HO, grasp.R_HO)
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        found = find_unreachable(grasp, linear_reference(start, 0.5 * direction, 1.0), 1.0)
        assert found is not None
        t, finger = found
        assert 0.0 < t <= 1.0
        assert finger in grasp.fingers


def test_the_command_refuses_such_a_motion_before_it_simulates(capsys):
    for options in ([], ["--joint-friction", "0.05"]):
        assert main(["simulate", "--travel", "0,0,0.3", "--duration", "100", *options]) == 1
        err = capsys.readouterr().err
        assert "--travel = '0,0,0.3'" in err
        assert "cannot follow its contact" in err
