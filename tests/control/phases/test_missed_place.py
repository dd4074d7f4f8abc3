"""Fingertips that slip off an edge, pass beside the object or touch it late show where the object is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graspforce.contact.contact import Contact, ContactSet
from graspforce.control.phases.missed_place import run_alone, shift_of_late_touch, shift_of_miss, shift_of_slip
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.touched_grasp import pose_from_touch, touched_grasp
from graspforce.geometry import Box
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand
from tests.support.table_scenes import ball_scene

DOWN = np.array([0.0, 0.0, -1.0])
TOLERANCE = 4e-3  # m
PLACES = ((0.0, 0.015, 0.0), (0.0, -0.015, 0.0), (0.0, 0.004, 0.0))  # m, of two fingers on a face and one opposite


@pytest.fixture(scope="module")
def grasp() -> Grasp:
    """Return three fingers on the faces of a box across x; the posture defines where the tips were at the touch."""
    hand = Hand.load("allegro_right")
    signs = (1.0, 1.0, -1.0)
    x = np.eye(3)[0]
    contacts = [Contact(np.array(p) - 0.02 * s * x, s * x, 0.6) for p, s in zip(PLACES, signs, strict=True)]
    q = hand.neutral
    p_HO = np.mean([hand.tip_pose(q, name)[0] for name in ("index", "middle")], axis=0)
    fingers = ("index", "middle", "thumb")
    return Grasp(hand, Body.solid(Box((0.04, 0.05, 0.06)), 0.1), fingers, ContactSet.stack(contacts), q, p_HO, np.eye(3))


def touched(grasp: Grasp) -> np.ndarray:
    return np.array([grasp.hand.tip_pose(grasp.q, name)[0] for name in grasp.fingers])


def moved(grasp: Grasp, runs) -> np.ndarray:
    """Return the places of the tips after runs (N,) along their inward normals, m."""
    return touched(grasp) + np.array(runs)[:, None] * grasp.contacts.R_OC[:, :, 2]


def test_object_that_moves_with_all_fingers_is_no_slip(grasp):
    for x in (-0.02, -0.005, 0.0, 0.005, 0.02):
        assert shift_of_slip(grasp, touched(grasp) + np.array([x, 0.0, 0.0]), DOWN, TOLERANCE) is None


@pytest.mark.parametrize("finger", [0, 1])
def test_finger_that_runs_alone_shifts_the_object_to_the_side_of_its_middle(grasp, finger):
    runs = np.zeros(3)
    runs[finger] = 0.015
    shift = shift_of_slip(grasp, moved(grasp, runs), DOWN, TOLERANCE)
    assert shift is not None
    towards_middle = grasp.p_HO - touched(grasp)[finger]
    assert shift @ towards_middle > 0.0
    assert shift @ DOWN == pytest.approx(0.0, abs=1e-12)  # m: along the table
    assert shift @ grasp.contacts.R_OC[finger, :, 2] == pytest.approx(0.0, abs=1e-12)  # m: along the face
    assert 4e-3 < np.linalg.norm(shift) < 12e-3  # m: between a contact's least distance from the edge and the largest error


def test_slip_does_not_depend_on_a_translation_of_the_object(grasp):
    runs = np.array([0.015, 0.0, 0.0])
    first = shift_of_slip(grasp, moved(grasp, runs), DOWN, TOLERANCE)
    second = shift_of_slip(grasp, moved(grasp, runs) + np.array([0.003, 0.0, 0.0]), DOWN, TOLERANCE)
    np.testing.assert_allclose(first, second, rtol=0, atol=1e-12)


def test_small_runs_are_no_slip(grasp):
    assert shift_of_slip(grasp, moved(grasp, [TOLERANCE, 0.0, 0.0]), DOWN, TOLERANCE) is None


def test_finger_at_the_middle_shows_no_side(grasp):
    centred = replace(grasp, p_HO=grasp.p_HO + np.array([0.0, touched(grasp)[0, 1] - grasp.p_HO[1], 0.0]))
    assert shift_of_slip(centred, moved(centred, [0.015, 0.0, 0.0]), DOWN, TOLERANCE) is None


def test_finger_beside_the_object_shifts_it_to_the_side_of_its_middle(grasp):
    for finger in (0, 1):
        beside = touched(grasp)[finger]
        shift = shift_of_miss(grasp, finger, beside, DOWN)
        assert shift @ (grasp.p_HO - beside) > 0.0
        assert shift @ DOWN == pytest.approx(0.0, abs=1e-12)  # m: along the table
    opposite = shift_of_miss(grasp, 0, 2.0 * grasp.p_HO - touched(grasp)[0], DOWN)
    np.testing.assert_allclose(opposite, -shift_of_miss(grasp, 0, touched(grasp)[0], DOWN), rtol=0, atol=1e-12)


def test_finger_that_closes_along_gravity_shows_no_side(grasp):
    assert shift_of_miss(grasp, 0, touched(grasp)[0], grasp.contacts.R_OC[0, :, 2]) is None


@pytest.mark.parametrize("finger", [0, 1, 2])
@pytest.mark.parametrize("run", [0.004, 0.018])
def test_late_touch_shows_the_true_place_of_the_object(finger, run):
    """A finger stops before a displaced ball, and touches it only in the squeeze; then all tips fit the ball."""
    scene, settings = ball_scene(), PhaseSettings()
    planned = scene.grasp
    along = 0.006 * np.linalg.svd(scene.down[None])[2][1]  # m
    true_tips = touched(planned) + along
    stopped = np.array(true_tips)
    stopped[finger] -= run * (planned.contacts.R_OC[finger, :, 2] @ planned.R_HO.T)
    pose = pose_from_touch(planned, stopped, scene.down, settings)
    before = touched_grasp(planned, posture_with_tips(planned, stopped), stopped, pose)
    assert run_alone(before, stopped)[1] == pytest.approx(0.0, abs=1e-6)  # m: accuracy of the posture
    shift = shift_of_late_touch(planned, before, true_tips, scene.down, settings)
    if run <= settings.contact_tolerance:
        assert shift is None
    else:
        np.testing.assert_allclose(shift, along, rtol=0, atol=1e-3)  # m: contact error


def test_touch_in_time_is_no_late_touch():
    scene = ball_scene()
    tips = touched(scene.grasp)
    assert shift_of_late_touch(scene.grasp, scene.grasp, tips, scene.down, PhaseSettings()) is None


def posture_with_tips(grasp: Grasp, p_tip: np.ndarray) -> np.ndarray:
    """Return the posture (n,) with the fingertips at given places (N, 3), in H, m."""
    hand, q = grasp.hand, np.array(grasp.q)
    frames = [hand.frame_id(name) for name in grasp.fingers]
    for _ in range(50):
        p, J = (each[0] for each in hand.model.frame_jacobians(q[None], frames))
        rows = J[:, :3].reshape(-1, hand.n)
        q = q + np.linalg.pinv(rows, rcond=1e-6) @ (p_tip - p).ravel()
    return q
