"""A hold says where its fingers touch, and how far the posture is from that."""

from __future__ import annotations

import numpy as np
import pytest
from support.box_grasp import FINGERS, make_grasp

from graspforce import InvalidInput
from graspforce.core.errors import UnknownName


def test_fingers_that_touch_have_no_gap_and_a_shift_of_the_object_is_the_gap():
    grasp = make_grasp()
    np.testing.assert_allclose(grasp.contact_errors(), 0.0, atol=2e-9)  # inverse kinematics stops at a nanometre
    shift = np.array([1e-3, -2e-3, 2e-3])
    np.testing.assert_allclose(make_grasp(p_HO=grasp.p_HO + shift).contact_errors(), 3e-3, atol=2e-9)


def test_what_cannot_be_a_hold_is_refused():
    with pytest.raises(UnknownName, match="finger_9"):
        make_grasp(fingers=(*FINGERS[:3], "finger_9"))
    for fingers in (FINGERS[:3], (*FINGERS[:3], "finger_1")):
        with pytest.raises(InvalidInput, match="4 different fingers"):
            make_grasp(fingers=fingers)
    with pytest.raises(InvalidInput, match="q = "):
        make_grasp(q=np.zeros(5))
