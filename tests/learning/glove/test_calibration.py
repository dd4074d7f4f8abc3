"""Calibration of a simulated glove: cross-talk is removed, held-out errors are stated, and drift is noticed."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce.core.errors import InvalidInput
from graspforce.learning import GloveCalibration, SimulatedGlove, calibrate_glove

N_JOINTS = 16
JOINTS = tuple(f"joint_{i}" for i in range(N_JOINTS))
LOWER, UPPER = np.full(N_JOINTS, -0.2), np.full(N_JOINTS, 1.4)  # rad


def recorded(glove, pairs, seed, averaged=30):
    """Postures, and readings averaged over the frames of one second."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(LOWER, UPPER, (pairs, N_JOINTS))
    return np.mean([glove.readings(q, rng) for _ in range(averaged)], axis=0), q


def test_a_noiseless_linear_glove_is_inverted():
    glove = SimulatedGlove(LOWER, UPPER, noise=0.0)
    pairs, paired_q = recorded(glove, 60, 0, 1)
    calibration = calibrate_glove(pairs, JOINTS, paired_q, "linear")
    readings, q = recorded(glove, 50, 1, 1)
    np.testing.assert_allclose(calibration.postures(readings), q, atol=1e-4)  # the smallest ridge is 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_sixty_pairs_give_two_degrees(seed):
    """1 % noise is 0.9° of a single frame over a range of 92°; the frames of the test are not averaged."""
    glove = SimulatedGlove(LOWER, UPPER, noise=0.01, cross_talk=0.1, seed=seed)
    readings, q = recorded(glove, 60, seed)
    calibration = calibrate_glove(readings, JOINTS, q)
    test_readings, test_q = recorded(glove, 300, 100 + seed, 1)
    rms = np.degrees(np.sqrt(np.square(calibration.postures(test_readings) - test_q).mean()))
    assert rms <= 2.0


def test_cross_validation_states_the_held_out_error():
    """Single frames throughout: the stated error is that of new frames within a fifth (30 pairs in each of few folds)."""
    glove = SimulatedGlove(LOWER, UPPER, noise=0.02)
    readings, q = recorded(glove, 120, 0, 1)
    calibration = calibrate_glove(readings, JOINTS, q)
    test_readings, test_q = recorded(glove, 1000, 1, 1)
    held_out = np.sqrt(np.square(calibration.postures(test_readings) - test_q).mean())
    assert np.sqrt(np.square(calibration.rms).mean()) == pytest.approx(held_out, rel=0.2)


def test_curved_sensors_need_the_kernel():
    glove = SimulatedGlove(LOWER, UPPER, noise=0.002, curvature=0.6)
    readings, q = recorded(glove, 200, 0)
    chosen, linear = calibrate_glove(readings, JOINTS, q), calibrate_glove(readings, JOINTS, q, "linear")
    assert chosen.method == "kernel"
    assert np.square(chosen.rms).mean() < 0.8 * np.square(linear.rms).mean()


def test_a_linear_glove_keeps_the_linear_fit():
    readings, q = recorded(SimulatedGlove(LOWER, UPPER), 60, 0)
    assert calibrate_glove(readings, JOINTS, q).method == "linear"


@pytest.mark.parametrize("method", ["linear", "kernel"])
def test_a_file_returns_the_calibration(method, tmp_path):
    readings, q = recorded(SimulatedGlove(LOWER, UPPER), 40, 0)
    calibration = calibrate_glove(readings, JOINTS, q, method)
    calibration.save(tmp_path / "glove.json")
    read = GloveCalibration.load(tmp_path / "glove.json")
    np.testing.assert_array_equal(read.postures(readings), calibration.postures(readings))
    assert read.joints == JOINTS
    assert read.method == method


def test_drift_is_noticed_and_its_absence_too():
    glove = SimulatedGlove(LOWER, UPPER, drift=0.001)  # 0.1 % of the range in a second
    readings, q = recorded(glove, 60, 0)
    calibration = calibrate_glove(readings, JOINTS, q)
    flat, rng = np.zeros(N_JOINTS), np.random.default_rng(5)
    frames = np.tile(flat, (30, 1))
    assert calibration.drift(glove.readings(frames, rng), flat).joints == ()
    drifted = calibration.drift(glove.readings(frames, rng, t=120.0), flat)
    assert len(drifted.joints) > N_JOINTS / 2
    assert np.abs(drifted.error).max() > np.radians(5.0)  # 12 % of 92° is the standard deviation of the drift


def test_a_dead_sensor_has_no_effect():
    readings, q = recorded(SimulatedGlove(LOWER, UPPER), 60, 0)
    dead = np.hstack([readings, np.full((60, 1), 7.0)])
    with_dead, without = calibrate_glove(dead, JOINTS, q, "linear"), calibrate_glove(readings, JOINTS, q, "linear")
    np.testing.assert_allclose(with_dead.postures(dead), without.postures(readings), atol=1e-9)


def test_invalid_arguments_are_refused(tmp_path):
    readings, q = recorded(SimulatedGlove(LOWER, UPPER), 20, 0)
    calibration = calibrate_glove(readings, JOINTS, q, "linear")
    (tmp_path / "other.json").write_text('{"schema": "x"}')
    for call in (
        lambda: calibrate_glove(readings[:9], JOINTS, q[:9]),
        lambda: calibrate_glove(readings, JOINTS[:-1], q),
        lambda: calibrate_glove(readings, JOINTS, q, "cubic"),
        lambda: calibration.posture(readings[0][:-1]),
        lambda: calibration.drift(readings[:0], q[0]),
        lambda: GloveCalibration.load(tmp_path / "other.json"),
        lambda: SimulatedGlove(UPPER, LOWER),
        lambda: SimulatedGlove(LOWER, UPPER, noise=-1.0),
    ):
        with pytest.raises(InvalidInput):
            call()
