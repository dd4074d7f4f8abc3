"""A fingertip that slips off the edge of its face shows on which side of it the object is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graspforce.contact.contact import Contact, ContactSet
from graspforce.control.phases.missed_place import shift_of_slip
from graspforce.geometry import Box
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import Hand

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
