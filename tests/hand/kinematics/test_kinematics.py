"""Kinematics of the hands against published closed forms, and the laws between positions, velocities and forces."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest
from scipy.optimize import least_squares
from support.hand_closed_forms import (
    FINGER_BASES,
    FOUR_FINGER_LENGTHS,
    TIP_POSES,
    dlr_hit2_jacobian,
    four_finger_joint_angles,
    four_finger_tip_jacobian,
    four_finger_tip_pose,
)
from support.hands import SHIPPED_HANDS, hand_finger_pairs, load, random_posture

from graspforce.contact.contact import Contact, ContactSet
from graspforce.core.errors import InvalidInput, UnknownName

EXACT = 1e-12  # m and 1: about ten roundings of numbers of order one
STEP = 1e-6  # rad: central differences have errors STEP² ≈ 1e-12 (truncation) and 1e-16/STEP = 1e-10 (rounding)
DIFFERENCED = 1e-8

CLOSED = sorted(FINGER_BASES)


def rotation_vector(R_after: np.ndarray, R_before: np.ndarray) -> np.ndarray:
    """Return the small rotation vector between two orientations."""
    S = R_after @ R_before.T
    return np.array([S[2, 1] - S[1, 2], S[0, 2] - S[2, 0], S[1, 0] - S[0, 1]]) / 2


# ── published closed forms ─────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(("name", "finger"), CLOSED)
def test_tip_pose_equals_the_corrected_closed_form(name: str, finger: str) -> None:
    hand = load(name)
    p_HF, R_HF = FINGER_BASES[name, finger]
    chosen = list(hand.finger(finger).joints)
    for seed in range(50):
        q = random_posture(hand, seed)
        p, R = TIP_POSES[name](q[chosen])
        p_H, R_H = hand.tip_pose(q, finger)
        np.testing.assert_allclose(p_H, p_HF + R_HF @ p, atol=EXACT, rtol=0)
        np.testing.assert_allclose(R_H, R_HF @ R, atol=EXACT, rtol=0)


@pytest.mark.parametrize("finger", ["finger_1", "finger_2", "finger_3", "finger_4"])
def test_tip_jacobian_of_four_finger_equals_mattar_equation_23(finger: str) -> None:
    hand = load("four_finger")
    chosen = list(hand.finger(finger).joints)
    for seed in range(50):
        q = random_posture(hand, seed)
        p, R = hand.tip_pose(q, finger)
        J = hand.point_jacobian(q, finger, p)
        np.testing.assert_allclose(R.T @ J[:3, chosen], four_finger_tip_jacobian(q[chosen]), atol=EXACT, rtol=0)


@pytest.mark.parametrize("finger", ["thumb", "index", "middle", "ring", "little"])
def test_coupled_jacobian_of_dlr_hit2_equals_corrected_equation_12(finger: str) -> None:
    hand = load("dlr_hit2")
    chosen = list(hand.finger(finger).joints)
    _, R_HF = FINGER_BASES["dlr_hit2", finger]
    for seed in range(50):
        q = random_posture(hand, seed)
        J = hand.point_jacobian(q, finger, hand.tip_pose(q, finger)[0])
        np.testing.assert_allclose(J[:3, chosen], R_HF @ dlr_hit2_jacobian(q[chosen]), atol=EXACT, rtol=0)


# ── laws of any hand ───────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(("name", "finger"), hand_finger_pairs(SHIPPED_HANDS))
def test_jacobian_is_the_derivative_of_the_pose(name: str, finger: str) -> None:
    hand = load(name)
    q = random_posture(hand, 7)
    p, R = hand.tip_pose(q, finger)
    local = np.array([0.004, -0.007, 0.011])  # m, a point of the last link, in the tip's axes
    J = hand.point_jacobian(q, finger, p + R @ local)
    differences = np.zeros((6, hand.n))
    for i in range(hand.n):
        step = STEP * np.eye(hand.n)[i]
        (p_1, R_1), (p_0, R_0) = hand.tip_pose(q + step, finger), hand.tip_pose(q - step, finger)
        differences[:3, i] = (p_1 + R_1 @ local - p_0 - R_0 @ local) / (2 * STEP)
        differences[3:, i] = rotation_vector(R_1, R_0) / (2 * STEP)
    np.testing.assert_allclose(J, differences, atol=DIFFERENCED, rtol=0)
    others = [i for i in range(hand.n) if i not in hand.finger(finger).joints]
    assert not J[:, others].any()


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_contact_power_equals_motor_power(name: str) -> None:
    """fᵀ J v is the power of the contact forces on the fingers, for all contact models."""
    hand = load(name)
    rng = np.random.default_rng(11)
    q, v = random_posture(hand, 3), rng.normal(size=hand.n)
    R_HO, p_HO = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3) / 10
    R_HO *= np.linalg.det(R_HO)
    names = [hand.fingers[i % len(hand.fingers)].name for i in (0, 1, 2, 0)]
    models = ["point", "frictionless", "soft", "soft"]
    places = [hand.tip_pose(q, finger)[0] + rng.normal(size=3) / 100 for finger in names]
    contacts = ContactSet.stack(
        [
            Contact(R_HO.T @ (p - p_HO), rng.normal(size=3), 0.5, model=model, torsional_friction=0.01)
            for p, model in zip(places, models, strict=True)
        ]
    )
    f = rng.normal(size=contacts.size)
    J = hand.contact_jacobian(q, names, contacts, p_HO, R_HO)
    assert J.shape == (3 + 1 + 4 + 4, hand.n)

    power = 0.0
    for i, (finger, p, padded) in enumerate(zip(names, places, contacts.pad(f), strict=True)):
        (p_0, R_0), (p_1, R_1), (p_2, R_2) = (hand.tip_pose(q + s * STEP * v, finger) for s in (0, 1, -1))
        local = R_0.T @ (p - p_0)
        velocity = (p_1 + R_1 @ local - p_2 - R_2 @ local) / (2 * STEP)
        R_HC = R_HO @ contacts.R_OC[i]
        power += padded[:3] @ R_HC.T @ velocity + padded[3] * R_HC[:, 2] @ rotation_vector(R_1, R_2) / (2 * STEP)
    assert f @ J @ v == pytest.approx(power, abs=10 * DIFFERENCED)


def test_force_along_a_stretched_finger_loads_no_flexion_motor() -> None:
    """Known answer: the line of force intersects the axes of all its joints."""
    hand = load("four_finger")
    p, R = hand.tip_pose(np.zeros(12), "finger_1")
    contacts = ContactSet.stack([Contact(p, R[:, 0], 0.5)])
    J = hand.contact_jacobian(np.zeros(12), ["finger_1"], contacts, np.zeros(3), np.eye(3))
    np.testing.assert_allclose(J[2], 0.0, atol=EXACT)
    assert np.abs(J[:2, :3]).max() > sum(FOUR_FINGER_LENGTHS) - EXACT  # sideways the lever is the whole finger


def test_contact_jacobian_rejects_invalid_arguments() -> None:
    hand = load("four_finger")
    contacts = ContactSet.stack([Contact([0, 0, 0], [0, 0, 1], 0.5)])
    with pytest.raises(InvalidInput, match="list of 12 numbers"):
        hand.contact_jacobian(np.zeros(11), ["finger_1"], contacts, np.zeros(3), np.eye(3))
    with pytest.raises(InvalidInput, match=r"q\[2\] = nan"):
        hand.tip_pose([0, 0, np.nan] + [0] * 9, "finger_1")
    with pytest.raises(InvalidInput, match="one for each contact"):
        hand.contact_jacobian(np.zeros(12), ["finger_1", "finger_2"], contacts, np.zeros(3), np.eye(3))
    with pytest.raises(InvalidInput, match="one for each contact"):
        hand.contact_jacobian(np.zeros(12), "finger_1", contacts, np.zeros(3), np.eye(3))
    with pytest.raises(UnknownName, match="finger_1, finger_2, finger_3, finger_4"):
        hand.contact_jacobian(np.zeros(12), ["finger_5"], contacts, np.zeros(3), np.eye(3))
    for R in (2 * np.eye(3), np.diag([1.0, 1.0, -1.0])):
        with pytest.raises(InvalidInput, match="R_HO"):
            hand.contact_jacobian(np.zeros(12), ["finger_1"], contacts, np.zeros(3), R)


# ── inverse kinematics ─────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(("name", "finger"), hand_finger_pairs(SHIPPED_HANDS))
def test_inverse_kinematics_reaches_every_reachable_point(name: str, finger: str) -> None:
    hand = load(name)
    chosen = list(hand.finger(finger).joints)
    for seed in range(20):
        p, _ = hand.tip_pose(random_posture(hand, seed), finger)
        q = np.array(hand.neutral)
        q[chosen] = hand.inverse_kinematics(finger, p)
        np.testing.assert_allclose(hand.tip_pose(q, finger)[0], p, atol=1e-6)  # m, the documented tolerance
        assert (q >= hand.q_lower).all()
        assert (q <= hand.q_upper).all()


def test_inverse_kinematics_equals_the_corrected_closed_form() -> None:
    hand = load("four_finger")
    p_HF, R_HF = FINGER_BASES["four_finger", "finger_3"]
    rng = np.random.default_rng(5)
    for _ in range(20):
        q = rng.uniform([-0.7, -0.7, 0.2], [0.7, 0.7, 0.7])
        p = p_HF + R_HF @ four_finger_tip_pose(q)[0]
        np.testing.assert_allclose(four_finger_joint_angles(four_finger_tip_pose(q)[0]), q, atol=1e-12)
        found = hand.inverse_kinematics("finger_3", p)
        # Two postures reach most points, elbow up and elbow down. The neutral posture, the start, has the elbow up.
        np.testing.assert_allclose(found, q, atol=1e-6)


def test_inverse_kinematics_along_a_path_has_no_jumps() -> None:
    """Started from the previous posture, a step is at most the tip's step over the smallest singular value of J."""
    hand = load("dlr_hit2")
    q = np.array(hand.neutral)
    chosen = list(hand.finger("index").joints)
    centre, _ = hand.tip_pose(q, "index")
    for t in np.linspace(0, 2 * np.pi, 500):
        p = centre + 0.004 * np.array([np.cos(t) - 1, np.sin(t), np.sin(2 * t) / 2])
        found = hand.inverse_kinematics("index", p, q)
        J = hand.point_jacobian(q, "index", hand.tip_pose(q, "index")[0])[:3, chosen]
        step = 2 * np.linalg.norm(p - hand.tip_pose(q, "index")[0]) / np.linalg.svd(J, compute_uv=False)[-1]
        assert np.linalg.norm(found - q[chosen]) <= step + 1e-9
        q[chosen] = found


def test_error_for_a_point_out_of_reach_gives_the_distance() -> None:
    """A point 50 mm beyond the tip of a stretched finger: the nearest reachable point is that tip."""
    hand = load("four_finger")
    p_HF, R_HF = FINGER_BASES["four_finger", "finger_2"]
    with pytest.raises(InvalidInput, match=r"50\.00 mm away") as caught:
        hand.inverse_kinematics("finger_2", p_HF + R_HF[:, 0] * (sum(FOUR_FINGER_LENGTHS) + 0.050))
    tip = p_HF + R_HF[:, 0] * sum(FOUR_FINGER_LENGTHS)
    assert ", ".join(f"{x:.4f}" for x in tip) in str(caught.value)


def test_four_fingers_carry_a_box_15_mm_along_y_and_z() -> None:
    """Al-Gallaf, section V: the object moves along y and z without rotation; box 60 mm wide, tip radius 8 mm."""
    hand = load("four_finger")
    margin = np.inf
    for y in np.linspace(-0.015, 0.015, 7):
        for z in np.linspace(-0.015, 0.015, 7):
            for finger in hand.fingers:
                side, (_, row, _) = (
                    np.sign(hand.tip_pose(hand.neutral, finger.name)[0][0]),
                    FINGER_BASES["four_finger", finger.name][0],
                )
                chosen = list(finger.joints)
                q = hand.inverse_kinematics(finger.name, [side * 0.038, row + y, 0.055 + z])
                margin = min(margin, np.min(q - hand.q_lower[chosen]), np.min(hand.q_upper[chosen] - q), q[2])
    assert margin > 0.1  # rad, from every limit and from the singular stretched posture


@pytest.mark.parametrize(("axis", "travel"), [(0, 0.006), (1, 0.015), (2, 0.015)])
def test_box_travel_stays_within_45_degrees_by_the_closed_form(axis: int, travel: float) -> None:
    """The purpose of the chosen lengths and bases; Mattar (2013) gives the joint ranges only."""
    for distance in np.linspace(-travel, travel, 13):
        for i in range(1, 5):
            p_HF, R_HF = FINGER_BASES["four_finger", f"finger_{i}"]
            tip = np.array([np.copysign(0.038, p_HF[0]), p_HF[1], 0.055]) + distance * np.eye(3)[axis]
            q = four_finger_joint_angles(R_HF.T @ (tip - p_HF))
            np.testing.assert_allclose(four_finger_tip_pose(q)[0], R_HF.T @ (tip - p_HF), atol=1e-12)
            assert np.abs(q).max() < radians(44)
            assert q[2] > radians(20)  # far from stretched


def box_contacts() -> ContactSet:
    """Return the contacts of the box in the neutral posture of four_finger: two on each of the sides x = ±30 mm."""
    rows = [(1, 0.0225), (1, -0.0225), (-1, -0.0225), (-1, 0.0225)]
    return ContactSet.stack([Contact([side * 0.030, y, 0.0], [-side, 0, 0], 0.5) for side, y in rows])


def test_centres_of_round_tips_are_one_radius_outside_the_contacts() -> None:
    """Also for a rotated and translated object."""
    hand, contacts = load("four_finger"), box_contacts()
    names = [finger.name for finger in hand.fingers]
    angle = np.deg2rad(5)
    R_HO = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    p_HO = np.array([0.0, 0.004, 0.060])
    q = hand.grasp_posture(names, contacts, p_HO, R_HO)
    for i, name in enumerate(names):
        contact = p_HO + R_HO @ contacts.p_OC[i]
        np.testing.assert_allclose(hand.tip_pose(q, name)[0], contact - 0.008 * R_HO @ contacts.R_OC[i, :, 2], atol=1e-6)
    np.testing.assert_allclose(hand.grasp_posture(names, contacts, [0, 0, 0.055], np.eye(3)), hand.neutral, atol=1e-3)


def test_error_without_a_grasp_posture_names_the_contact() -> None:
    hand, contacts = load("four_finger"), box_contacts()
    names = [finger.name for finger in hand.fingers]
    with pytest.raises(InvalidInput, match=r"contacts\[0\]\.p_H = .* within reach of finger_1: .* mm away"):
        hand.grasp_posture(names, contacts, [0, 0, 0.200], np.eye(3))
    with pytest.raises(InvalidInput, match="different fingers"):
        hand.grasp_posture(["finger_1"] * 4, contacts, [0, 0, 0.055], np.eye(3))


@pytest.mark.parametrize("name", ["dlr_hit2", "anthropomorphic15"])
@pytest.mark.parametrize("finger", ["index", "middle", "ring"])
def test_thumb_opposes_the_fingers(name: str, finger: str) -> None:
    """The purpose of the chosen places of the thumbs: their tips can touch those of the fingers."""
    hand = load(name)
    chosen = [*hand.finger("thumb").joints, *hand.finger(finger).joints]
    q = np.array(hand.neutral)

    def gap(q_both: np.ndarray) -> np.ndarray:
        q[chosen] = q_both
        return hand.tip_pose(q, "thumb")[0] - hand.tip_pose(q, finger)[0]

    margin = 0.02  # rad
    bounds = (hand.q_lower[chosen] + margin, hand.q_upper[chosen] - margin)
    solution = least_squares(gap, np.clip(hand.neutral[chosen], *bounds), bounds=bounds, xtol=1e-12, gtol=1e-12, ftol=1e-15)
    assert np.linalg.norm(solution.fun) < 1e-6  # m
