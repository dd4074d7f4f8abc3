"""Dynamics of the hands against their energies, published closed forms, and a sum over the bodies of a coupled finger."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from support.hand_closed_forms import (
    ANTHROPOMORPHIC15_CENTRES,
    ANTHROPOMORPHIC15_DYNAMICS_LENGTHS,
    ANTHROPOMORPHIC15_MASSES,
    ANTHROPOMORPHIC15_PRINTED_CENTRES,
    FINGER_BASES,
    anthropomorphic15_torques,
    dlr_hit2_bodies,
)
from support.hands import SHIPPED_HANDS, load, random_posture

from graspforce.contact.contact import Contact, ContactSet
from graspforce.core.errors import InvalidInput
from graspforce.hand.hand import Hand

ROUNDING = 1e-13  # N·m: torques are of order 0.1 N·m

GRAVITIES = [sign * 9.81 * axis for axis in np.eye(3) for sign in (1.0, -1.0)]


def motion(hand: Hand, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return q, v and a of a smooth motion within the limits, with a different frequency for each joint."""
    middle, half = (hand.q_upper + hand.q_lower) / 2, (hand.q_upper - hand.q_lower) / 4
    w = 3.0 + np.arange(hand.n) * 0.37  # rad/s
    return middle + half * np.sin(w * t), half * w * np.cos(w * t), -half * w**2 * np.sin(w * t)


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_motor_power_is_the_rate_of_the_energy(name: str) -> None:
    """tau·v = d(K + U)/dt along a motion: relates inertia, Coriolis and gravity torques to the two energies."""
    hand, g, h = load(name), np.array([3.0, -5.0, -7.0]), 1e-5
    for t in (0.1, 0.77, 1.9):
        q, v, a = motion(hand, t)
        tau = hand.inverse_dynamics(q, v, a, g)
        after, before = (sum(hand.energy(*motion(hand, t + s)[:2], g)) for s in (h, -h))
        # energies of order 0.1 J: rounding 1e-17/h, truncation h²·w³ of order 1e-8 of the power
        assert tau @ v == pytest.approx((after - before) / (2 * h), rel=1e-7, abs=1e-9)
        assert abs(tau @ v) > 1e-4  # W: the comparison is not of zeros


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_mass_matrix_is_that_of_the_kinetic_energy_and_positive_definite(name: str) -> None:
    hand = load(name)
    rng = np.random.default_rng(0)
    for seed in range(10):
        q, v = random_posture(hand, seed), rng.normal(size=hand.n)
        M = hand.mass_matrix(q)
        np.testing.assert_array_equal(M, M.T)
        assert np.linalg.eigvalsh(M)[0] > 0.9 * hand.rotor_inertia.min()  # the links add to the rotors
        kinetic, _ = hand.energy(q, v)
        assert v @ M @ v / 2 == pytest.approx(kinetic, rel=1e-12)
        a = rng.normal(size=hand.n)
        still = hand.inverse_dynamics(q, np.zeros(hand.n), a, np.zeros(3))
        np.testing.assert_allclose(M @ a, still, atol=ROUNDING)


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_gravity_torque_is_the_gradient_of_the_potential_energy(name: str) -> None:
    hand, h = load(name), 1e-5
    q = random_posture(hand, 4)
    for g in GRAVITIES:
        steps = h * np.eye(hand.n)
        rest = np.zeros(hand.n)
        gradient = [(hand.energy(q + s, rest, g)[1] - hand.energy(q - s, rest, g)[1]) / (2 * h) for s in steps]
        torque = hand.gravity_torque(q, g)
        np.testing.assert_allclose(torque, gradient, atol=1e-10)  # rounding 1e-17 J / h, truncation h²
        np.testing.assert_allclose(torque, hand.inverse_dynamics(q, rest, rest, g), atol=ROUNDING)
    # Gravity torques are linear in gravity.
    np.testing.assert_allclose(hand.gravity_torque(q, GRAVITIES[0]), -hand.gravity_torque(q, GRAVITIES[1]), atol=ROUNDING)
    np.testing.assert_allclose(hand.gravity_torque(q, np.zeros(3)), 0.0, atol=ROUNDING)


# ── digital-twin hand study ────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("finger", ["index", "middle", "ring", "little", "thumb"])
def test_torques_equal_the_corrected_equations_of_the_study(finger: str) -> None:
    """Equations (16)-(18), with c_i from the base along links of 50, 37, 30 mm. There, joint 2 has the opposite sign."""
    hand = load("anthropomorphic15")
    chosen, sign = list(hand.finger(finger).joints), np.array([1.0, -1.0, 1.0])
    x_F = FINGER_BASES["anthropomorphic15", finger][1][:, 0]
    rng = np.random.default_rng(8)
    for seed in range(20):
        q, v, a = random_posture(hand, seed), rng.normal(size=15), rng.normal(size=15)
        links = hand.inverse_dynamics(q, v, a, 9.81 * x_F) - hand.rotor_inertia * a
        published = anthropomorphic15_torques(sign * q[chosen], sign * v[chosen], sign * a[chosen], 9.81)
        np.testing.assert_allclose(links[chosen], sign * published, atol=ROUNDING)


def test_reported_torques_are_static_torques_of_a_horizontal_finger() -> None:
    """The study reports step peaks of 0.059, 0.037 and 0.018 N·m. Its c_i and l_i give the first two at rest."""
    horizontal = np.array([np.pi / 2, 0.0, 0.0])
    rest = np.zeros(3)
    as_printed = anthropomorphic15_torques(
        horizontal, rest, rest, 9.81, ANTHROPOMORPHIC15_DYNAMICS_LENGTHS, ANTHROPOMORPHIC15_PRINTED_CENTRES
    )
    np.testing.assert_allclose(np.abs(as_printed), [0.0596, 0.0376, 0.0168], atol=5e-5)  # the printed digits

    hand = load("anthropomorphic15")
    index = list(hand.finger("index").joints)
    torque = hand.gravity_torque(np.zeros(15))[index]  # palm up: the stretched finger is horizontal
    (m1, m2, m3), (c1, c2, c3) = ANTHROPOMORPHIC15_MASSES, ANTHROPOMORPHIC15_CENTRES
    by_hand = 9.81 * np.array([m1 * c1 + m2 * (0.050 + c2) + m3 * (0.087 + c3), m2 * c2 + m3 * (0.037 + c3), m3 * c3])
    np.testing.assert_allclose(torque, by_hand, atol=ROUNDING)


# ── a coupled finger, body by body ─────────────────────────────────────────────────────────────────────────────────────────


def test_energies_of_a_coupled_finger_are_sums_over_its_bodies() -> None:
    """K = Σ ½ m|ċ|² + ½ ωᵀIω + ½ Σ D v², U = −Σ m g·c, with link poses from the study's matrices and θ4 = θ3."""
    hand = load("dlr_hit2")
    p_HF, R_HF = FINGER_BASES["dlr_hit2", "middle"]
    chosen = list(hand.finger("middle").joints)
    rng, h, g = np.random.default_rng(9), 1e-6, np.array([1.0, 4.0, -9.0])
    for seed in range(10):
        q = random_posture(hand, seed)
        v = np.zeros(15)
        v[chosen] = rng.normal(size=3)
        kinetic = 0.5 * float(hand.rotor_inertia @ v**2)
        before, now, after = (dlr_hit2_bodies(q[chosen] + t * v[chosen]) for t in (-h, 0.0, h))
        for (m, inertia, _, R), (_, _, c0, R0), (_, _, c1, R1) in zip(now, before, after, strict=True):
            S = R1 @ R0.T
            omega = np.array([S[2, 1] - S[1, 2], S[0, 2] - S[2, 0], S[1, 0] - S[0, 1]]) / (4 * h)
            kinetic += m * ((c1 - c0) @ (c1 - c0)) / (8 * h**2) + omega @ R @ inertia @ R.T @ omega / 2
        # The URDF's inertias have six digits. Without θ4 = θ3 the first digit would differ.
        assert hand.energy(q, v)[0] == pytest.approx(kinetic, rel=1e-6)

        moved = np.array(q)
        moved[chosen] = random_posture(hand, seed + 100)[chosen]
        difference = hand.energy(moved, v, g)[1] - hand.energy(q, v, g)[1]
        weights = [sum(m * g @ (p_HF + R_HF @ c) for m, _, c, _ in dlr_hit2_bodies(x[chosen])) for x in (moved, q)]
        assert difference == pytest.approx(weights[1] - weights[0], abs=1e-14)


def test_followers_move_with_their_leaders() -> None:
    hand = load("dlr_hit2")
    assert hand.T.shape == (20, 15)
    q = random_posture(hand, 1)
    full = dict(zip(hand.full_joints, hand.T @ q + hand.q0, strict=True))
    for finger in hand.fingers:
        assert full[f"{finger.name}_joint_4"] == full[f"{finger.name}_joint_3"] == q[finger.joints[2]]


# ── actuation and threads ──────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_actuation_collects_jacobian_torques_and_limits(name: str) -> None:
    hand = load(name)
    rng = np.random.default_rng(1)
    q, v, a, g = random_posture(hand, 2), rng.normal(size=hand.n), rng.normal(size=hand.n), np.array([0.0, 9.81, 0.0])
    names = [finger.name for finger in hand.fingers]
    contacts = ContactSet.stack([Contact(rng.normal(size=3) / 20, rng.normal(size=3), 0.7) for _ in names])
    p_HO, R_HO = np.array([0.01, 0.02, 0.08]), np.diag([1.0, -1.0, -1.0])
    actuation = hand.actuation(q, names, contacts, p_HO, R_HO, tau_u=hand.inverse_dynamics(q, v, a, g))
    np.testing.assert_array_equal(actuation.J, hand.contact_jacobian(q, names, contacts, p_HO, R_HO))
    np.testing.assert_array_equal(actuation.tau_u, hand.inverse_dynamics(q, v, a, g))
    np.testing.assert_array_equal(actuation.upper, hand.torque_upper)
    np.testing.assert_array_equal(actuation.lower, [-joint.torque for joint in hand.joints])
    np.testing.assert_array_equal(actuation.weight, hand.force_weight)
    # The defaults are rest and palm up.
    np.testing.assert_allclose(hand.actuation(q, names, contacts, p_HO, R_HO).tau_u, hand.gravity_torque(q), atol=ROUNDING)


def test_threads_with_different_gravity_are_independent() -> None:
    """Pinocchio keeps gravity in the model and results in the data: threads must share neither."""
    hand = load("allegro_right") if "allegro_right" in SHIPPED_HANDS else load("four_finger")
    postures = [random_posture(hand, seed) for seed in range(40)]
    alone = [[hand.gravity_torque(q, g) for q in postures] for g in GRAVITIES[:2]]
    found: list[list[np.ndarray]] = [[], []]
    together = threading.Barrier(2)

    def work(i: int) -> None:
        together.wait()
        for _ in range(20):
            found[i] = [hand.gravity_torque(q, GRAVITIES[i]) for q in postures]

    threads = [threading.Thread(target=work, args=(i,)) for i in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    np.testing.assert_array_equal(found, alone)


def test_dynamics_reject_invalid_vectors() -> None:
    hand = load("four_finger")
    with pytest.raises(InvalidInput, match="gravity_H = "):
        hand.gravity_torque(np.zeros(12), [0, -9.81])
    with pytest.raises(InvalidInput, match="v = "):
        hand.energy(np.zeros(12), np.zeros(3))
    with pytest.raises(InvalidInput, match=r"a\[0\] = inf"):
        hand.inverse_dynamics(np.zeros(12), np.zeros(12), [np.inf] + [0] * 11)
