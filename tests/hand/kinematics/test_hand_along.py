"""Functions of many postures equal those of one posture, posture by posture."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.hands import SHIPPED_HANDS, load, random_posture

from graspforce.contact.contact import Contact, ContactSet
from graspforce.core.errors import InvalidInput

ROUNDING = 1e-13


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_functions_along_a_path_equal_those_at_each_posture(name: str) -> None:
    hand, rng = load(name), np.random.default_rng(2)
    fingers = [finger.name for finger in hand.fingers]
    q = np.array([random_posture(hand, seed) for seed in range(4)])
    v, a = rng.normal(size=(2, 4, hand.n))
    p_HO, R_HO = rng.normal(size=(4, 3)) * 0.05, Rotation.random(4, random_state=3).as_matrix()
    models = [("point", None), ("soft", 0.01), ("frictionless", None), ("point", None), ("soft", 0.02)]
    contacts = ContactSet.stack(
        [
            Contact(rng.normal(size=3) * 0.03, rng.normal(size=3), 0.5, model, torsional_friction=gamma)
            for _, (model, gamma) in zip(fingers, models, strict=False)
        ]
    )
    gravity = np.array([3.0, -5.0, -7.0])
    tau = hand.inverse_dynamics_along(q, v, a, gravity)
    J = hand.contact_jacobian_along(q, fingers, contacts, p_HO, R_HO)
    tips, J_tips = hand.tips_along(q, fingers)
    for k in range(4):
        assert tau[k] == pytest.approx(hand.inverse_dynamics(q[k], v[k], a[k], gravity), abs=ROUNDING)
        assert J[k] == pytest.approx(hand.contact_jacobian(q[k], fingers, contacts, p_HO[k], R_HO[k]), abs=ROUNDING)
        for i, finger in enumerate(fingers):
            tip, _ = hand.tip_pose(q[k], finger)
            assert tips[k, i] == pytest.approx(tip, abs=ROUNDING)
            assert J_tips[k, i] == pytest.approx(hand.point_jacobian(q[k], finger, tip)[:3], abs=ROUNDING)


def test_functions_along_a_path_reject_invalid_shapes() -> None:
    hand = load("four_finger")
    with pytest.raises(InvalidInput, match="q = "):
        hand.tips_along(np.zeros((3, hand.n + 1)), ["finger_1"])
    with pytest.raises(InvalidInput, match="v = "):
        hand.inverse_dynamics_along(np.zeros((3, hand.n)), np.zeros((2, hand.n)), np.zeros((3, hand.n)))
