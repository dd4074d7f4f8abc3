"""Motions that the contacts allow: all for fingertips with enough joints, none that moves a point on the palm."""

from __future__ import annotations

import numpy as np
from support.hands import load
from support.link_grasps import power_grasp

from graspforce.control import feasible_twists
from graspforce.control.contacts.feasible_twists import contacts_at_rest
from graspforce.grasp.search import find_grasp


def test_fingertips_with_three_joints_allow_every_motion() -> None:
    hand = load("four_finger")
    twists = feasible_twists(find_grasp(hand, power_grasp("dlr_hit2").body, friction=0.6))
    np.testing.assert_allclose(twists.T @ twists, np.eye(6), atol=1e-12)


def test_an_object_on_the_palm_moves_at_no_contact_with_it() -> None:
    grasp = power_grasp("allegro_right").as_grasp()
    twists, rolling = feasible_twists(grasp), contacts_at_rest(grasp)
    assert len(twists) < 4  # the palm takes three, and each further link more
    np.testing.assert_allclose(twists @ twists.T, np.eye(len(twists)), atol=1e-12)
    palm = grasp.fingers.index("palm_link")
    for twist in twists:
        in_O = (twist.reshape(2, 3) @ grasp.R_HO).ravel()
        velocity = rolling.B[3 * palm : 3 * palm + 3] @ in_O
        assert np.linalg.norm(velocity) < 1e-9
        # some joint motion follows, up to the constraints that count as none
        joints = np.linalg.lstsq(rolling.A, rolling.B @ in_O, rcond=1e-3)[0]
        assert np.linalg.norm(rolling.A @ joints - rolling.B @ in_O) < 2e-3


def test_a_fixed_object_has_no_motion() -> None:
    assert feasible_twists(power_grasp("dlr_hit2").as_grasp()).shape == (0, 6)
