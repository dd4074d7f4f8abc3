"""Idle fingers relax towards the neutral posture, and keep clear of the object and of other fingers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hands import load

from graspforce import InvalidInput
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import find_grasp, relax_idle_fingers


@pytest.fixture(scope="module")
def grasp():
    hand = load("allegro_right")
    return find_grasp(hand, Body.solid(Sphere(0.03), 0.05), ["index", "middle", "thumb"], friction=0.7, gravity_H=(0, 0, -9.81))


def test_idle_finger_takes_its_neutral_posture(grasp):
    ring, others = (list(grasp.hand.finger("ring").joints), [0, 1, 2, 3, 4, 5, 6, 7])
    relaxed = relax_idle_fingers(grasp)
    np.testing.assert_array_equal(relaxed.q[ring], grasp.hand.neutral[ring])
    np.testing.assert_array_equal(relaxed.q[others], grasp.q[others])
    np.testing.assert_array_equal(relaxed.contacts.p_OC, grasp.contacts.p_OC)


def test_idle_finger_stops_at_the_clearance(grasp):
    """The object in the way of the ring finger: it stops between stretched and neutral, at least the clearance away."""
    hand, ring = grasp.hand, list(grasp.hand.finger("ring").joints)
    q = grasp.q.copy()
    q[ring] = hand.neutral[ring]
    blocked = replace(grasp, p_HO=hand.tip_pose(q, "ring")[0] + [0.0, 0.0, -0.02])
    shares = []
    for clearance in (0.0, 0.007, 0.014):
        relaxed = relax_idle_fingers(blocked, clearance)
        distance = np.linalg.norm(hand.tip_pose(relaxed.q, "ring")[0] - blocked.p_HO) - 0.03 - hand.finger("ring").tip_radius
        assert distance >= clearance - 1e-12
        shares.append(np.linalg.norm(relaxed.q[ring]) / np.linalg.norm(hand.neutral[ring]))
    assert 0.2 < shares[2] < shares[0] < 1.0
    with pytest.raises(InvalidInput, match="clearance"):
        relax_idle_fingers(grasp, -0.01)
