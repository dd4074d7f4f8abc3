"""Kinematics on the wire: the numbers of the hand, and errors that name the field."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.hands import load

from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.service.server.request_handler import RequestHandler
from graspforce.service.wire import protocol
from graspforce.service.wire.kinematics_records import forward_record, inverse_record, read_posture, read_tip_poses

HANDS = ["four_finger", "allegro_right", "shadow_right", "parallel_jaws"]


@pytest.mark.parametrize("name", HANDS)
def test_forward_returns_poses_and_jacobians_of_all_tips(name):
    hand = load(name)
    q = hand.q_lower + 0.4 * (hand.q_upper - hand.q_lower)
    tips = read_tip_poses(json.loads(json.dumps(forward_record(hand, {"posture": q.tolist()}))))
    assert list(tips) == [finger.name for finger in hand.fingers]
    for finger, tip in tips.items():
        p, R = hand.tip_pose(q, finger)
        np.testing.assert_allclose(tip.p_HF, p, atol=1e-15)
        np.testing.assert_allclose(tip.R_HF, R, atol=1e-15)
        np.testing.assert_allclose(tip.jacobian, hand.point_jacobian(q, finger, p), atol=1e-15)


@pytest.mark.parametrize("name", HANDS)
def test_inverse_of_forward_puts_the_tips_back(name):
    hand = load(name)
    q = hand.neutral + 0.1 * (0.5 * (hand.q_lower + hand.q_upper) - hand.neutral)
    tips = read_tip_poses(forward_record(hand, {"posture": q.tolist()}))
    shared = [j for j in range(hand.n) if sum(j in finger.joints for finger in hand.fingers) > 1]
    request = {"tips": {finger: tip.p_HF.tolist() for finger, tip in tips.items()}, "start": q.tolist()}
    found = read_posture(json.loads(json.dumps(inverse_record(hand, request))))
    np.testing.assert_array_equal(found[shared], q[shared])
    for finger, tip in tips.items():
        np.testing.assert_allclose(hand.tip_pose(found, finger)[0], tip.p_HF, atol=1e-6)  # m: tolerance of a reached target


@pytest.mark.parametrize(
    ("record", "field"),
    [
        ({}, "posture"),
        ({"posture": [0.0]}, "posture"),
        ({"posture": [float("nan")] * 12}, "posture"),
        ({"posture": [0.0] * 12, "finger": "finger_1"}, "finger"),
    ],
)
def test_forward_names_the_wrong_field(record, field):
    with pytest.raises(InvalidInput) as error:
        forward_record(load("four_finger"), record)
    assert error.value.field.startswith(field)


@pytest.mark.parametrize(
    ("record", "field"),
    [
        ({}, "tips"),
        ({"tips": {}}, "tips"),
        ({"tips": [[0, 0, 0]]}, "tips"),
        ({"tips": {"finger_1": [0, 0]}}, "tips.finger_1"),
        ({"tips": {"finger_1": [1, 0, 0]}}, "tips.finger_1"),
        ({"tips": {"finger_1": [0.03, 0.0225, 0.055]}, "start": [0]}, "start"),
    ],
)
def test_inverse_names_the_wrong_field(record, field):
    with pytest.raises(InvalidInput) as error:
        inverse_record(load("four_finger"), record)
    assert error.value.field == field


def test_inverse_lists_the_fingers_of_the_hand():
    with pytest.raises(UnknownName, match="finger_1"):
        inverse_record(load("four_finger"), {"tips": {"finger_0": [0, 0, 0]}})


def test_handler_answers_both_keys_and_rejects_a_choice_of_solver():
    handler = RequestHandler([load("four_finger")])
    posture = load("four_finger").neutral.tolist()
    reply = handler.answer("hands/four_finger/forward", json.dumps({"posture": posture, "sequence": 4}).encode())
    assert reply.ok
    assert protocol.decode(reply.payload, reply.encoding)["sequence"] == 4
    refused = handler.answer("hands/four_finger/inverse", json.dumps({"tips": {}, "backend": "clarabel"}).encode())
    assert not refused.ok
    assert json.loads(refused.payload)["field"] == "backend"
    unknown = handler.answer("hands/two_finger/forward", b"{}")
    assert json.loads(unknown.payload)["error"] == "unknown"
