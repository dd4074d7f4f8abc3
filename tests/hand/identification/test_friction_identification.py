"""Identified friction is the true one within its confidence interval, and joints without enough motion are reported."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.friction_recordings import friction_recording
from support.hands import load

from graspforce.core.errors import InvalidInput
from graspforce.hand.drives.joint_friction import JointFriction
from graspforce.hand.identification.friction_identification import IdentificationSettings, identify_friction
from graspforce.hand.identification.joint_recording import JointRecording

FRICTION = JointFriction(np.linspace(0.03, 0.1, 12), viscous=np.linspace(0.004, 0.001, 12))


def test_friction_of_an_exact_recording_is_found() -> None:
    """The smoothing filter mixes the two directions at reversals, beyond which 1 % remains."""
    identified = identify_friction(load("four_finger"), friction_recording(load("four_finger"), FRICTION))
    np.testing.assert_allclose(identified.coulomb, FRICTION.coulomb, rtol=0.01)
    np.testing.assert_allclose(identified.viscous, FRICTION.viscous, atol=1e-3)
    np.testing.assert_allclose(identified.offset, 0.0, atol=1e-3)


@pytest.mark.parametrize("name", ["four_finger", "dlr_hit2"])
def test_confidence_intervals_contain_the_truth(name: str) -> None:
    """95 % intervals of all joints of three noisy recordings: at least 85 % hold the truth, and they are not idle."""
    hand = load(name)
    true = JointFriction(np.full(hand.n, 0.06), viscous=np.full(hand.n, 0.003))
    hits, errors = [], []
    for seed in range(3):
        recording = friction_recording(hand, true, encoder_noise=2e-4, torque_noise=0.01, seed=seed)
        identified = identify_friction(hand, recording)
        hits.append(np.abs(identified.coulomb - 0.06) <= identified.coulomb_error + 3e-4)  # N·m, of the filter at reversals
        errors.append(identified.coulomb_error)
    assert np.mean(hits) >= 0.85
    assert np.max(errors) < 0.01  # N·m, a sixth of the friction


def test_stribeck_friction_below_the_threshold_does_not_bias() -> None:
    hand = load("four_finger")
    true = JointFriction(np.full(12, 0.06), np.full(12, 0.03), np.full(12, 0.02))
    identified = identify_friction(hand, friction_recording(hand, true), IdentificationSettings(slowest_rate=0.1))
    np.testing.assert_allclose(identified.coulomb, 0.06, rtol=0.02)


def test_measured_rates_serve_as_well() -> None:
    hand = load("four_finger")
    recording = friction_recording(hand, FRICTION)
    v = np.gradient(recording.q, recording.t, axis=0)
    identified = identify_friction(hand, JointRecording(recording.t, recording.q, recording.tau, v))
    np.testing.assert_allclose(identified.coulomb, FRICTION.coulomb, rtol=0.01)


def test_uneven_times_are_interpolated() -> None:
    hand = load("four_finger")
    recording = friction_recording(hand, FRICTION)
    kept = np.random.default_rng(0).uniform(size=len(recording.t)) > 0.3
    thinned = JointRecording(recording.t[kept], recording.q[kept], recording.tau[kept])
    identified = identify_friction(hand, thinned)
    np.testing.assert_allclose(identified.coulomb, FRICTION.coulomb, rtol=0.03)


def test_constant_torque_error_is_an_offset_and_not_friction() -> None:
    hand = load("four_finger")
    recording = friction_recording(hand, FRICTION)
    biased = dataclasses.replace(recording, tau=recording.tau + 0.05)
    ours, plain = identify_friction(hand, biased), identify_friction(hand, recording)
    np.testing.assert_allclose(ours.coulomb, plain.coulomb, atol=1e-9)
    np.testing.assert_allclose(ours.offset - plain.offset, 0.05, atol=1e-9)


def test_joints_without_enough_motion_are_not_identified() -> None:
    """One joint rests, one moves in one direction only; both stay without source in the model."""
    hand = load("four_finger")
    recording = friction_recording(hand, FRICTION)
    q, tau = np.array(recording.q), np.array(recording.tau)
    q[:, 0] = 0.1
    q[:, 1] = 0.1 * recording.t - 0.5
    identified = identify_friction(hand, JointRecording(recording.t, q, tau))
    assert not identified.is_identified[:2].any()
    assert identified.is_identified[2:].all()
    model = identified.friction("test")
    assert model.sources[:3] == ("", "", "test")
    assert len(identified.description("test")) == 10
    assert identified.to_dict()["coulomb"][:2] == [None, None]
    assert "–" in str(identified)


def test_one_speed_does_not_tell_viscous_from_coulomb_friction() -> None:
    """A triangular motion has one speed: the sum of both is reported as Coulomb friction, and no viscous friction."""
    hand = load("four_finger")
    t = np.arange(5000) / 500.0
    wave = 0.3 * (np.abs((t[:, None] + 0.1 * np.arange(12)) % 2.0 - 1.0) - 0.5)  # rad; ±0.3 rad/s
    q = 0.5 * (hand.q_lower + hand.q_upper) + wave
    v = np.gradient(wave, t, axis=0)
    tau = hand.inverse_dynamics_along(q, v, np.zeros_like(q)) + FRICTION.coulomb * np.sign(v) + FRICTION.viscous * v
    identified = identify_friction(hand, JointRecording(t, q, tau), IdentificationSettings(slowest_rate=0.25))
    assert np.isnan(identified.viscous).all()
    np.testing.assert_allclose(identified.coulomb, FRICTION.coulomb + 0.3 * FRICTION.viscous, rtol=0.03)


def test_recordings_of_other_hands_and_short_ones_are_refused() -> None:
    recording = friction_recording(load("four_finger"), FRICTION, duration=0.3)
    with pytest.raises(InvalidInput, match=r"recording\.q"):
        identify_friction(load("dlr_hit2"), recording)
    with pytest.raises(InvalidInput, match="four times the filter's window"):
        identify_friction(load("four_finger"), recording, IdentificationSettings(window=0.2))
    with pytest.raises(InvalidInput, match="blocks"):
        IdentificationSettings(blocks=2)
