"""Motion of tips and links in one pass over the joints, against differences in time."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import Rotation
from support.hands import SHIPPED_HANDS, load, random_posture

from graspforce import Hand
from graspforce.core.arrays import Array
from graspforce.hand.kinematics.coupled_model import CoupledModel

JAWS = ("parallel_jaws",)  # joints that slide in a straight line: no drift


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_twist_and_drift_are_derivatives_of_the_tip_poses(name: str) -> None:
    """Along q(t) = q + v t the joints do not accelerate, so the accelerations of the tips are the drift."""
    hand = load(name)
    rng = np.random.default_rng(3)
    names, h = [finger.name for finger in hand.fingers], 1e-4  # s
    for seed in range(1, 5):
        q, v = random_posture(hand, seed), rng.normal(0.0, 2.0, hand.n)
        tips = hand.tip_motion(q, v, names)
        for i, finger in enumerate(names):
            (p0, R0), (p, R), (p1, R1) = (hand.tip_pose(q + t * v, finger) for t in (-h, 0.0, h))
            forward, backward = (Rotation.from_matrix(b @ a.T).as_rotvec() / h for a, b in ((R, R1), (R0, R)))
            np.testing.assert_array_equal(tips.p_HF[i], p)
            np.testing.assert_array_equal(tips.R_HF[i], R)
            # Second order: h² = 1e-8 times third derivatives of some 100 m/s³; and rounding, 1e-17/h for p, 1e-16/h for R.
            np.testing.assert_allclose(tips.twist[i], [*(p1 - p0) / (2 * h), *(forward + backward) / 2], atol=1e-5)
            # Second differences: the same truncation, and rounding 1e-17/h², 1e-16/h².
            np.testing.assert_allclose(tips.drift[i], [*(p1 - 2 * p + p0) / h**2, *(forward - backward) / h], atol=2e-5)
        assert name in JAWS or np.abs(tips.drift).max() > 1e-2  # the comparison is not of zeros


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_tip_jacobian_is_that_of_the_point_at_the_tip(name: str) -> None:
    hand = load(name)
    rng = np.random.default_rng(4)
    names = [hand.fingers[-1].name, hand.fingers[0].name]  # in any order, not all of them
    q, v = random_posture(hand, 7), rng.normal(size=hand.n)
    tips = hand.tip_motion(q, v, names)
    for i, finger in enumerate(names):
        np.testing.assert_allclose(tips.J[i], hand.point_jacobian(q, finger, tips.p_HF[i]), atol=1e-15)
    np.testing.assert_allclose(tips.twist, tips.J @ v, atol=1e-14)
    faster = hand.tip_motion(q, 3.0 * v, names)
    np.testing.assert_allclose(faster.drift, 9.0 * tips.drift, rtol=1e-12, atol=1e-12)  # centripetal: quadratic in the rates


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_link_motion_gives_poses_jacobians_and_their_rates(name: str) -> None:
    """Twists at H's origin against point Jacobians there, and J̇ against a difference in time."""
    hand, rng, h = load(name), np.random.default_rng(5), 1e-5  # s
    model, q, v = hand.model, random_posture(hand, 8), rng.normal(0.0, 2.0, hand.n)
    for finger in hand.fingers:
        moved = model.joints_moving(finger.tip)
        assert set(moved) <= {0.0, 1.0}
        link, p_LF, R_LF = model.carrier_of(finger.tip)
        links = model.link_motion(q, v)
        p_HL, R_HL = links.link_poses[2 * (link + 1) : 2 * (link + 2)]
        p_HF, R_HF = hand.tip_pose(q, finger.name)
        np.testing.assert_allclose(p_HL + R_HL @ p_LF, p_HF, atol=1e-15)
        np.testing.assert_allclose(R_HL @ R_LF, R_HF, atol=1e-14)
        at_origin = (links.J * moved) @ model.T
        np.testing.assert_allclose(at_origin, hand.point_jacobian(q, finger.name, np.zeros(3)), atol=1e-14)
    # Second order, h² = 1e-10 times third derivatives of some 1e3 1/s³; and rounding, 1e-16/h.
    later, earlier = (model.link_motion(q + t * v, v).J.copy() for t in (h, -h))
    np.testing.assert_allclose(model.link_motion(q, v).J_rate, (later - earlier) / (2.0 * h), atol=1e-7)
    assert name in JAWS or np.abs(model.link_motion(q, v).J_rate).max() > 0.1
    assert len(hand.fingers) == len({tuple(model.joints_moving(finger.tip)) for finger in hand.fingers})  # each its own joints


def test_link_motion_without_shared_memory() -> None:
    """The arrays are copies then, new in each call."""
    q, v = np.linspace(0.1, 0.7, 16), np.linspace(-1.0, 2.0, 16)
    expected = Hand.load("allegro_right").model.link_motion(q, v)
    pinocchio.sharedMemory(False)
    try:
        model = Hand.load("allegro_right").model
        model.link_motion(np.zeros(16), np.zeros(16))
        result = model.link_motion(q, v)
    finally:
        pinocchio.sharedMemory(True)
    np.testing.assert_array_equal(result.J, expected.J)
    np.testing.assert_array_equal(result.J_rate, expected.J_rate)
    np.testing.assert_array_equal(result.link_poses[-1], expected.link_poses[-1])


def test_repeated_link_motion_is_that_of_its_arguments() -> None:
    """Also after every other method has used the workspace, after a change in place, and beside another thread."""
    hand, rng = load("allegro_right"), np.random.default_rng(9)
    model, tips = hand.model, [hand.frame_id(finger.name) for finger in hand.fingers]
    q, v, g = random_posture(hand, 10), rng.normal(size=hand.n), np.array([0.0, 0.0, -9.81])
    other = random_posture(hand, 11)
    uses: list[Callable[[], object]] = [
        lambda: None,
        lambda: model.frame_pose(other, tips[0]),
        lambda: model.link_poses(other),
        lambda: model.joint_origins(other),
        lambda: model.frame_jacobians(other[None], tips),
        lambda: model.tip_motion(other, v, tips),
        lambda: model.link_motion(other, v),
        lambda: model.link_motion(q, other),
        lambda: model.mass_matrix(other),
        lambda: model.gravity_torque(other, g),
        lambda: model.inverse_dynamics(other, v, v, g),
        lambda: model.energy(other, v, g),
    ]

    def numbers(q: Array, v: Array, model: CoupledModel = model) -> bytes:
        motion = model.link_motion(q, v)
        return b"".join(array.tobytes() for array in (motion.J, motion.J_rate, *motion.link_poses))

    expected = numbers(q, v, Hand.load("allegro_right").model)
    for use in uses:
        model.link_motion(q, v)
        use()
        assert numbers(q, v) == expected
    with ThreadPoolExecutor(1) as thread:
        assert thread.submit(numbers, other, v).result() != expected
        assert numbers(q, v) == expected
        assert thread.submit(numbers, q, v).result() == expected
    q[3] += 1e-12
    assert numbers(q, v) == numbers(q.copy(), v, Hand.load("allegro_right").model) != expected
    assert not any(array.flags.writeable for array in (*model.link_motion(q, v).link_poses, model.link_motion(q, v).J))


def test_gravity_is_that_of_the_last_call() -> None:
    """The workspace keeps gravity between calls; also a change in place of the same array has an effect."""
    hand, rest = load("allegro_right"), np.zeros(16)
    q, gravity = random_posture(hand, 9), np.array([0.0, 0.0, -9.81])
    first = hand.model.inverse_dynamics(q, rest, rest, gravity)
    gravity[:] = [9.81, 0.0, 0.0]
    turned = hand.model.inverse_dynamics(q, rest, rest, gravity)
    assert np.abs(turned - first).max() > 1e-3  # N·m
    np.testing.assert_array_equal(turned, hand.inverse_dynamics(q, rest, rest, (9.81, 0.0, 0.0)))
    np.testing.assert_array_equal(first, hand.inverse_dynamics(q, rest, rest, (0.0, 0.0, -9.81)))
    np.testing.assert_array_equal(hand.gravity_torque(q, gravity), turned)
