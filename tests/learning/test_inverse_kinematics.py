"""Learned start values: networks fit known maps, and the numeric solution from a prediction takes fewer steps."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from support import hands

from graspforce.core.errors import InvalidInput
from graspforce.hand.kinematics import inverse_kinematics as numeric
from graspforce.learning import FingerStart, fit_finger_start, fit_network
from graspforce.learning.inverse_kinematics import finger_patterns


@cache
def index_start() -> FingerStart:
    return fit_finger_start(hands.load("dlr_hit2"), "index", patterns=300, members=2, hidden=20)


def test_a_smooth_map_is_learned():
    rng = np.random.default_rng(0)
    x = rng.uniform(-1.0, 1.0, (400, 2))
    y = np.column_stack([np.sin(2.0 * x[:, 0]) * x[:, 1], 5.0 + 100.0 * x[:, 0]])
    network, test = fit_network(x[:300], y[:300], 20), x[300:]
    error = network.predict(test) - y[300:]
    assert np.abs(error / y.std(axis=0)).max() < 0.05


def test_one_output_and_constant_inputs_are_allowed():
    x = np.column_stack([np.linspace(0.0, 1.0, 50), np.full(50, 3.0)])
    network = fit_network(x, 2.0 * x[:, :1] + 1.0, 5)
    np.testing.assert_allclose(network.predict(x), 2.0 * x[:, :1] + 1.0, atol=1e-2)
    assert network.predict(x[0]).shape == (1,)


def test_predictions_are_near_the_target_and_within_the_limits():
    hand, start = hands.load("dlr_hit2"), index_start()
    places, found = finger_patterns(hand, "index", 100, np.random.default_rng(7))
    predicted = np.array([start.predict(p) for p in places])
    assert (predicted >= start.lower).all()
    assert (predicted <= start.upper).all()
    assert np.sqrt(np.square(predicted - found).mean()) < np.radians(6.0)  # of ranges of 40° and 90°


def test_the_solution_reaches_the_target_from_every_prediction_in_fewer_steps():
    hand, start = hands.load("dlr_hit2"), index_start()
    places, _ = finger_patterns(hand, "index", 100, np.random.default_rng(8))
    joints, frame, count = list(start.joints), [hand.frame_id("index")], [0]

    def tip(q_finger):
        count[0] += 1
        q = np.array(hand.neutral)
        q[joints] = q_finger
        p, J = hand.model.frame_jacobians(q[None], frame)
        return p[0, 0], J[0, 0, :3, joints].T

    steps = []
    for first in (lambda p: hand.neutral[joints], start.predict):
        count[0] = 0
        for p in places:
            assert numeric.solve(tip, p, start.lower, start.upper, [first(p)]).distance <= numeric.REACH_TOLERANCE
        steps.append(count[0])
    assert steps[1] < 0.8 * steps[0]


def test_the_posture_replaces_the_joints_of_the_finger_only():
    hand, start = hands.load("dlr_hit2"), index_start()
    p = hand.tip_pose(hand.neutral, "index")[0]
    q = start.posture(hand.neutral, p)
    others = [i for i in range(hand.n) if i not in start.joints]
    np.testing.assert_array_equal(q[others], hand.neutral[others])
    reached = hand.inverse_kinematics("index", p, q)
    np.testing.assert_allclose(reached, hand.neutral[list(start.joints)], atol=1e-3)


def test_invalid_arguments_are_refused():
    hand = hands.load("dlr_hit2")
    for call in (
        lambda: fit_network(np.zeros((1, 2)), np.zeros((1, 1))),
        lambda: fit_network(np.zeros((5, 2)), np.zeros((4, 1))),
        lambda: fit_network(np.zeros((5, 2)), np.zeros((5, 1)), 0),
        lambda: fit_finger_start(hand, "tail"),
        lambda: fit_finger_start(hand, "index", patterns=5),
        lambda: index_start().posture(hand.neutral, [0.0, 1.0]),
    ):
        with pytest.raises(InvalidInput):
            call()
