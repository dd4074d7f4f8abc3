"""CasADi expressions of a finger: torques, tips and their derivatives equal Pinocchio's."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce import Hand
from graspforce.hand.descriptions.description import shipped_hands
from graspforce.planning.nlp.symbolic_finger import symbolic_finger

TOLERANCE = 1e-12  # relative to the largest value: rounding through a chain of four links


@pytest.mark.parametrize("name", shipped_hands())
def test_torques_and_tips_equal_pinocchio(name: str) -> None:
    hand = Hand.load(name)
    rng = np.random.default_rng(3)
    posture = rng.uniform(hand.q_lower, hand.q_upper)
    for finger in (each.name for each in hand.fingers):
        model = symbolic_finger(hand, finger, posture)
        chosen = list(model.joints)
        q, v, a = posture.copy(), np.zeros(hand.n), np.zeros(hand.n)
        q[chosen] = rng.uniform(hand.q_lower, hand.q_upper)[chosen]
        v[chosen], a[chosen] = rng.normal(0.0, 3.0, len(chosen)), rng.normal(0.0, 50.0, len(chosen))
        gravity = rng.normal(0.0, 6.0, 3)
        tau = hand.inverse_dynamics(q, v, a, gravity)[chosen]
        torque = np.array(model.torque(q[chosen], v[chosen], a[chosen], gravity)).ravel()
        np.testing.assert_allclose(torque, tau, atol=TOLERANCE * np.abs(tau).max())

        p_HF = hand.tip_pose(q, finger)[0]
        np.testing.assert_allclose(np.array(model.tip(q[chosen])).ravel(), p_HF, atol=TOLERANCE)
        J = hand.point_jacobian(q, finger, p_HF)[:, chosen]
        np.testing.assert_allclose(np.array(model.jacobian(q[chosen])), J, atol=TOLERANCE)

        def velocity(step: float, q=q, v=v, finger=finger):  # type: ignore[no-untyped-def]
            q_then = q + step * v
            return hand.point_jacobian(q_then, finger, hand.tip_pose(q_then, finger)[0]) @ v

        h = 1e-4  # s: central differences; error h²/6 times the third derivative, about |v|² times the bias
        bias = np.array(model.bias(q[chosen], v[chosen])).ravel()
        np.testing.assert_allclose(bias, (velocity(h) - velocity(-h)) / (2 * h), atol=h**2 * (v @ v) * np.abs(bias).max())
