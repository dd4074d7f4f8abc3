"""Motions of the object that the fingers can and cannot follow."""

from __future__ import annotations

import numpy as np
import pytest
from support.control_grasps import named_grasp

from graspforce.cli import main
from graspforce.contact.motion import BodyMotion
from graspforce.simulation import constant_reference, linear_reference, rotation_reference
from graspforce.simulation.loops.reach import find_unholdable, find_unreachable

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


def test_motions_that_the_fingers_can_hold_pass(grasp):
    start, gravity = BodyMotion(grasp.p_HO, grasp.R_HO), np.array([0.0, 0.0, -9.81])
    assert find_unholdable(grasp, constant_reference(start), 1.0, gravity) is None
    for z in (-2e-3, 5e-4):  # m: two of the grasps are at the upper end of their range
        assert find_unholdable(grasp, linear_reference(start, np.array([0.0, 0.0, z]), 1.0), 1.0, gravity) is None


def test_a_load_beyond_the_motors_cannot_be_held(grasp):
    """With a hundred times the gravity, no forces within the limits hold the object at the start."""
    start = BodyMotion(grasp.p_HO, grasp.R_HO)
    found = find_unholdable(grasp, constant_reference(start), 1.0, np.array([0.0, 0.0, -981.0]))
    assert found is not None
    assert found[0] == 0.0
    assert found[1]


def test_the_command_refuses_a_turn_in_which_a_finger_becomes_singular(capsys):
    """Along with 10 mm upwards, this turn stretches the ring finger of the LEAP hand; in simulation, it drops the ball."""
    assert main(["simulate", "--hand", "leap_right", "--reference", "reach", "--turn", "0.15,0,0.2", "--duration", "100"]) == 1
    err = capsys.readouterr().err
    assert "--turn = '0.15,0,0.2'" in err
    assert "ring loses a direction" in err
