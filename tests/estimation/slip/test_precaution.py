"""Precaution: forces and motion that differ from the commanded ones, with known probability in noise alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp

from graspforce.contact.motion import BodyMotion
from graspforce.estimation import GraspEstimator, Measurement, SensorModel
from graspforce.estimation.grasp_monitor import GraspMonitor
from graspforce.estimation.slip.precaution import PrecautionTest

PERIOD, NOISE = 1e-3, 1e-3  # s, rad
HOURS = 3600.0  # s


class Slip(NamedTuple):
    """The quantities of the slip detector that the test reads."""

    residual: np.ndarray
    force_statistic: float = 0.0
    force_level: float = 1.0


GRASP = three_finger_grasp()
CONTACTS = GraspEstimator(GRASP, SensorModel(NOISE), PERIOD).initial_memory(Measurement(0.0, GRASP.q), 50).pose
POSE = BodyMotion(CONTACTS.p_HO, CONTACTS.R_HO)


def make_test(interval=100.0 * HOURS):
    return PrecautionTest(3, NOISE**2, PERIOD, interval)


def noisy_slips(count, seed, slip=None):
    """Yield slips of encoder noise, and of a slip (count, 3, 2) along the surface, m."""
    rng, A = np.random.default_rng(seed), CONTACTS.A.reshape(3, 4, -1)[:, :3].reshape(9, -1)
    for k in range(count):
        residual = A @ (NOISE * rng.normal(size=GRASP.hand.n))
        if slip is not None:
            residual.reshape(3, 3)[:, :2] += slip[k]
        yield Slip(residual)


def first_due(test, slips, desired=POSE):
    """Return the first period in which a precaution is due; None if there is none."""
    memory = None
    for k, slip in enumerate(slips):
        is_due, memory = test.step(memory, slip, CONTACTS, desired)
        if is_due:
            return k
    return None


def test_noise_gives_precautions_no_more_often_than_stated():
    """With an interval of 2 s, half of it for the motion, 60 s give 15 at most: neighbouring periods are not independent."""
    test, memory, count, last = make_test(2.0), None, 0, False
    for slip in noisy_slips(60_000, 0):
        is_due, memory = test.step(memory, slip, CONTACTS, POSE)
        count, last = count + (is_due and not last), is_due
    assert 0 < count <= 15


def test_noise_gives_no_precaution_in_a_minute():
    assert first_due(make_test(), noisy_slips(60_000, 1)) is None


def test_thresholds_follow_from_the_interval():
    """Ten times the interval divides the probabilities by ten: exp(−x/2) for two degrees of freedom."""
    short, long = make_test(10.0 * HOURS), make_test(100.0 * HOURS)
    assert long.motion_threshold - short.motion_threshold == pytest.approx(2.0 * np.log(10.0))
    assert np.exp(-0.5 * long.motion_threshold) * 9.0 == pytest.approx(PERIOD / (200.0 * HOURS))
    assert long.force_threshold > short.force_threshold


@pytest.mark.parametrize("finger", [0, 1, 2])
def test_slow_slip_of_one_finger_is_seen_before_half_a_millimetre(finger):
    """Slip from 20 mm/s on at 0.6 m/s² along t₁: half a millimetre takes 17 ms."""
    t = PERIOD * np.maximum(np.arange(430) - 400, 0)
    slip = np.zeros((430, 3, 2))
    slip[:, finger, 0] = 0.02 * t + 0.3 * t * t
    due = first_due(make_test(), noisy_slips(430, 2, slip))
    assert due is not None
    assert due > 400
    assert slip[due, finger, 0] < 5e-4


def test_a_desired_motion_that_the_object_follows_is_expected():
    """Without slip, fingertips move over the surface of the desired pose only if the object does not follow it."""
    moved = BodyMotion(POSE.p_HO + np.array([1e-3, 0.0, 0.0]), POSE.R_HO)
    test, memory, due = make_test(), None, []
    for k, slip in enumerate(noisy_slips(500, 3)):
        is_due, memory = test.step(memory, slip, CONTACTS, POSE if k < 400 else moved)
        due.append(is_due)
    assert not any(due[:400])
    assert due[410]  # a push that holds the object back by 1 mm is no slip, and a reason for precaution


def test_unexpected_forces_are_a_reason_at_once_and_model_errors_raise_their_threshold():
    test, memory = make_test(), None
    for slip in noisy_slips(300, 4):
        _, memory = test.step(memory, slip, CONTACTS, POSE)
    for level, is_expected in ((1.0, True), (1.25, True), (20.0, False)):
        large = slip._replace(force_statistic=1.1 * test.force_threshold, force_level=level)
        assert test.step(memory, large, CONTACTS, POSE)[0] == is_expected
    assert not test.step(memory, slip._replace(force_statistic=0.9 * test.force_threshold), CONTACTS, POSE)[0]


def test_tracking_errors_raise_the_threshold_of_the_motion():
    """An oscillation of 0.3 mm is a reason at its beginning, and none once it has lasted."""
    swing = np.zeros((4000, 3, 2))
    swing[300:, :, 0] = 3e-4 * np.sin(2.0 * np.pi * 8.0 * PERIOD * np.arange(3700))[:, None]
    test, memory, due = make_test(), None, []
    for slip in noisy_slips(len(swing), 5, swing):
        is_due, memory = test.step(memory, slip, CONTACTS, POSE)
        due.append(is_due)
    assert any(due[300:400])
    assert not any(due[1500:])


def test_monitor_without_fingertip_forces_has_no_precaution():
    monitor = GraspMonitor(GRASP, SensorModel(NOISE, torque_noise=1e-3), PERIOD, PALM_UP)
    assert monitor.initial_memory().precaution is None
