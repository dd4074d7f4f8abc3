"""The grasp of a box by the four-finger hand, used by the tests of records."""

from __future__ import annotations

import numpy as np

from graspforce import Contact, ContactSet, Hand
from graspforce.geometry import Box
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp

FINGERS = ("finger_1", "finger_2", "finger_3", "finger_4")


def make_grasp(**change) -> Grasp:
    """Return the grasp of a box 60 mm wide, with some fields changed."""
    hand, body = Hand.load("four_finger"), Body.solid(Box([0.06, 0.06, 0.05]), 0.15)
    corners = [(0.03, 0.0225), (0.03, -0.0225), (-0.03, -0.0225), (-0.03, 0.0225)]
    contacts = ContactSet.stack([Contact([x, y, 0.0], [-x, 0.0, 0.0], 0.6) for x, y in corners])
    p_HO = np.array([0.0, 0.0, 0.055])
    q = hand.grasp_posture(FINGERS, contacts, p_HO, np.eye(3))
    values = {"hand": hand, "body": body, "fingers": FINGERS, "contacts": contacts, "q": q, "p_HO": p_HO, "R_HO": np.eye(3)}
    return Grasp(**{**values, **change})
