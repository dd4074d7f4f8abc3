"""A hold says where its fingers touch, and how far the posture is from that."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce import Contact, ContactSet, Hand, InvalidInput
from graspforce.body import Body
from graspforce.errors import UnknownName
from graspforce.hold import Hold
from graspforce.shapes import Box

FINGERS = ("finger_1", "finger_2", "finger_3", "finger_4")


def a_hold(**change) -> Hold:
    """The four-finger hand about a box 60 mm wide."""
    hand, body = Hand.load("four_finger"), Body.solid(Box([0.06, 0.06, 0.05]), 0.15)
    corners = [(0.03, 0.0225), (0.03, -0.0225), (-0.03, -0.0225), (-0.03, 0.0225)]
    contacts = ContactSet.stack([Contact([x, y, 0.0], [-x, 0.0, 0.0], 0.6) for x, y in corners])
    p_HO = np.array([0.0, 0.0, 0.055])
    q = hand.grasp_posture(FINGERS, contacts, p_HO, np.eye(3))
    said = {"hand": hand, "body": body, "fingers": FINGERS, "contacts": contacts, "q": q, "p_HO": p_HO, "R_HO": np.eye(3)}
    return Hold(**{**said, **change})


def test_fingers_that_touch_have_no_gap_and_a_shift_of_the_object_is_the_gap():
    hold = a_hold()
    np.testing.assert_allclose(hold.gaps(), 0.0, atol=2e-9)  # inverse kinematics stops at a nanometre
    shift = np.array([1e-3, -2e-3, 2e-3])
    np.testing.assert_allclose(a_hold(p_HO=hold.p_HO + shift).gaps(), 3e-3, atol=2e-9)


def test_what_cannot_be_a_hold_is_refused():
    with pytest.raises(UnknownName, match="finger_9"):
        a_hold(fingers=(*FINGERS[:3], "finger_9"))
    for fingers in (FINGERS[:3], (*FINGERS[:3], "finger_1")):
        with pytest.raises(InvalidInput, match="4 different fingers"):
            a_hold(fingers=fingers)
    with pytest.raises(InvalidInput, match="q = "):
        a_hold(q=np.zeros(5))
