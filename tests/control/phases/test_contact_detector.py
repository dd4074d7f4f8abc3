"""Contacts show in forces, in joint torques or in a stall, whichever the hand has; a free finger shows none."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce.control.phases.contact_detector import ClosingTargets, ContactDetector
from graspforce.control.phases.finger_servo import ServoStep
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.sensor_model import SensorModel
from graspforce.hand.drives.drive import Drive
from graspforce.hand.hand import Hand

SETTINGS, DT = PhaseSettings(), 1e-3
NORMALS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
HAND = Hand.load("four_finger")
TORQUES = SensorModel(torque_noise=0.01)
SERVO_HAND = HAND.with_drives(Drive("position", stiffness=20.0, damping=0.1))


def signs_of(hand, sensors, speed, force, tip_force=0.0, steps=300, free=100, lag=0.0, target=SETTINGS.close_speed):
    """Return the signs after a free stretch at full speed, and then with the given speed, force and lag of both fingers.

    Their targets move along the normals with the speed `target`, m/s.
    """
    detector = ContactDetector(hand, sensors, SETTINGS, DT)
    p = np.zeros((2, 3))
    memory = detector.initial_memory(p)
    signs = ("", "")
    for k in range(steps):
        is_free = k < free
        p = p + DT * (SETTINGS.close_speed if is_free else speed) * NORMALS
        disturbance = np.zeros((2, 3)) if is_free else -force * NORMALS
        servo = ServoStep(np.zeros(12), np.zeros(12), np.zeros(12), p, disturbance, np.zeros((2, 3)))
        wrench = None
        if sensors.tip_force_noise is not None:
            wrench = np.hstack([(0.0 if is_free else tip_force) * NORMALS, np.zeros((2, 3))])
        measurement = Measurement(DT * k, np.zeros(12), tip_wrench=wrench)
        targets = ClosingTargets(np.full(2, target), np.full(2, 0.0 if is_free else lag), np.full(2, SETTINGS.touch_force))
        signs, memory = detector.step(memory, measurement, servo, NORMALS, targets, is_free)
    return signs


def test_finger_in_free_motion_shows_no_contact():
    for sensors in (SensorModel(), TORQUES, SensorModel(tip_force_noise=0.02)):
        assert signs_of(HAND, sensors, SETTINGS.close_speed, 0.0) == ("", "")


def test_force_sensor_shows_contact_first():
    assert signs_of(HAND, SensorModel(tip_force_noise=0.01), SETTINGS.close_speed, 0.0, tip_force=0.2) == ("tip force",) * 2


def test_slow_finger_that_pushes_shows_contact_in_its_joints():
    assert signs_of(HAND, TORQUES, 0.2 * SETTINGS.close_speed, 0.2) == ("joint torque",) * 2


def test_position_servo_without_torque_sensors_shows_contact_by_a_stall():
    assert signs_of(SERVO_HAND, SensorModel(), 0.0, 0.2) == ("stall",) * 2


def test_finger_far_behind_its_target_shows_contact_by_a_stall():
    """Noise of the encoders may hide how slow a finger is; its distance to the target, which goes on, does not."""
    assert signs_of(SERVO_HAND, SensorModel(), 0.5 * SETTINGS.close_speed, 0.0, lag=0.003) == ("", "")
    assert signs_of(SERVO_HAND, SensorModel(), 0.5 * SETTINGS.close_speed, 0.0, lag=0.005) == ("stall",) * 2


def test_finger_that_moves_again_has_not_stalled():
    detector, p = ContactDetector(SERVO_HAND, SensorModel(), SETTINGS, DT), np.zeros((2, 3))
    servo = ServoStep(np.zeros(12), np.zeros(12), np.zeros(12), p, np.zeros((2, 3)), np.zeros((2, 3)))
    targets = ClosingTargets(np.full(2, SETTINGS.close_speed), np.zeros(2), np.ones(2))
    inputs = Measurement(0.0, np.zeros(12)), servo, NORMALS, targets, False
    memory = detector.initial_memory(p)
    for _ in range(300):
        signs, memory = detector.step(memory, *inputs)
    assert signs == ("stall",) * 2
    signs, _ = detector.step(detector.restarted(memory, np.array([True, False])), *inputs)
    assert signs == ("", "stall")


def test_finger_that_pushes_at_full_speed_is_not_stopped_by_a_disturbance():
    assert signs_of(HAND, TORQUES, SETTINGS.close_speed, 0.5) == ("", "")


def test_noise_of_the_force_sensor_raises_the_threshold():
    quiet, loud = (ContactDetector(HAND, SensorModel(tip_force_noise=s), SETTINGS, DT).force_threshold for s in (0.0, 0.1))
    assert quiet == pytest.approx(0.5 * SETTINGS.touch_force)
    assert loud > 0.1


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
@pytest.mark.parametrize("hand", [HAND, SERVO_HAND], ids=["torque", "servo"])
def test_tip_as_fast_as_its_target_has_not_stalled(hand, share):
    """The target of a finger of one joint is slower along the normal: cos² of the angle between its way and the normal."""
    speed = share * SETTINGS.close_speed
    assert signs_of(hand, SensorModel(), speed, 0.2, target=speed) == ("", "")
    expected = "joint torque" if hand is HAND else "stall"
    assert signs_of(hand, SensorModel(), 0.1 * speed, 0.2, target=speed) == (expected,) * 2


def test_tip_whose_target_rests_has_not_stalled():
    assert signs_of(SERVO_HAND, SensorModel(), 0.0, 0.2, target=0.0) == ("", "")
    assert signs_of(SERVO_HAND, SensorModel(), -1e-3, 0.2, target=0.0) == ("", "")


def test_force_sensor_whose_noise_hides_the_touch_force_does_not_count():
    """With 0.15 N at 1 kHz five deviations exceed the touch force of 0.2 N, which a waiting finger never exceeds."""
    noisy = SensorModel(tip_force_noise=0.15)
    assert ContactDetector(HAND, noisy, SETTINGS, DT).force_threshold > SETTINGS.touch_force
    touch = {"speed": 0.0, "force": 0.2, "tip_force": SETTINGS.touch_force}
    assert signs_of(HAND, noisy, **touch) == ("joint torque",) * 2
    assert signs_of(SERVO_HAND, noisy, **touch) == ("stall",) * 2
    assert signs_of(HAND, noisy, SETTINGS.close_speed, 0.0, tip_force=0.3) == ("", "")


def test_torque_sensors_do_not_replace_the_disturbance_of_position_servos():
    """The disturbance follows from commanded torques, which position servos do not apply."""
    assert signs_of(SERVO_HAND, TORQUES, 0.4 * SETTINGS.close_speed, 0.5) == ("", "")
    assert signs_of(SERVO_HAND, TORQUES, 0.0, 0.5) == ("stall",) * 2
