"""Phases in which the fingers move alone, while the hand's base moves or brakes."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce.control.joints.joint_trajectory import JointTrajectory
from graspforce.control.phases.cycle_plan import STOP_DECELERATION, BaseMotion
from graspforce.control.phases.finger_servo import ServoStep
from graspforce.control.phases.joint_phases import HoldJoints, JointPhase, ReopenPhase
from graspforce.control.phases.phase_rules import NOT_REACHED
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.estimation.measurement import Measurement
from graspforce.hand.hand import Hand

PERIOD, SETTINGS = 1e-3, PhaseSettings()
BOUND = np.full(2, 5.0)  # N


class FollowingServo:
    """Servo whose joints are behind their targets by a constant distance, with constant torques."""

    period = PERIOD

    def __init__(self, hand: Hand, lag: float = 0.0, tau: float = 0.0) -> None:
        self.hand, self._lag, self._tau = hand, lag, np.full(hand.n, tau)

    def step(self, memory, measurement, desired, bounds, *, is_free=False, learns=True, predicted=True):
        none = np.zeros((2, 3))
        return ServoStep(self._tau, desired.q - self._lag, desired.v, none, none, none), memory


def arrives(hand: Hand, lag: float) -> bool:
    """Return whether joints with a lag count as arrived."""
    motion = JointTrajectory.between(hand.neutral, hand.neutral + 1e-3, 0.1)
    phase = JointPhase(FollowingServo(hand, lag), motion, SETTINGS, BaseMotion.at_rest(np.zeros(3)), BOUND, False)
    return any(phase.step(PERIOD * k, Measurement(PERIOD * k, hand.neutral), None).is_over for k in range(400))


def test_joints_arrive_within_the_tolerance_of_their_kind():
    """30 mrad for a revolute joint, 1 mm for a prismatic one, whose range may be some centimetres."""
    slides, turns = Hand.load("parallel_jaws"), Hand.load("allegro_right")
    assert (arrives(slides, 0.9e-3), arrives(slides, 1.1e-3)) == (True, False)
    assert (arrives(turns, 0.029), arrives(turns, 0.031)) == (True, False)


@pytest.mark.parametrize(("lag", "expected"), [(0.02, 0.2), (0.08, 2.1), (0.1, None)])
def test_joints_that_friction_stops_near_the_posture_arrive_late(lag, expected):
    """The motion takes 0.1 s, and the joints rest for 0.1 s. From 2 s after it, 90 mrad are near enough."""
    hand = Hand.load("allegro_right")
    motion = JointTrajectory.between(hand.neutral, hand.neutral + 1e-3, 0.1)
    phase = JointPhase(FollowingServo(hand, lag), motion, SETTINGS, BaseMotion.at_rest(np.zeros(3)), BOUND, False)
    for k in range(2200):
        result = phase.step(PERIOD * k, Measurement(PERIOD * k, hand.neutral), None)
        if result.is_over or result.abort:
            break
    assert (result.is_over, result.abort) == ((True, "") if expected else (False, NOT_REACHED))
    assert PERIOD * k == pytest.approx(expected or 2.1, abs=3 * PERIOD)


def test_torques_accelerate_the_links_with_the_base():
    """In the axes of H the links weigh g − a: the torques of a reopening hand are those at rest and gravity_torque(q, −a)."""
    hand, displacement = Hand.load("allegro_right"), np.array([0.01, 0.02, -0.01])  # m
    servo, rest = FollowingServo(hand, tau=0.1), BaseMotion.at_rest(np.zeros(3))
    motion = JointTrajectory.between(hand.neutral, hand.neutral, 0.1)
    phase = ReopenPhase(hand, JointPhase(servo, motion, SETTINGS, rest, BOUND, False), displacement)
    moving = 0
    for k in range(1000):
        result = phase.step(PERIOD * k, Measurement(PERIOD * k, hand.neutral), None)
        moving += bool(result.base.a.any())
        expected = 0.1 + hand.gravity_torque(hand.neutral, -result.base.a)
        np.testing.assert_allclose(result.tau, expected, rtol=0, atol=1e-12)
        if result.is_over:
            break
    assert moving > 100
    np.testing.assert_allclose(result.base.p, displacement)


@pytest.mark.parametrize("speed", [0.0, 0.05, 0.3])
def test_base_brakes_in_a_stop_that_holds_the_joints(speed):
    hand, direction = Hand.load("allegro_right"), np.array([0.6, 0.0, -0.8])
    start = BaseMotion(np.array([0.1, 0.2, 0.3]), speed * direction, np.zeros(3))
    phase = HoldJoints(FollowingServo(hand), hand.neutral, start, BOUND)
    bases = [phase.step(PERIOD * k, Measurement(PERIOD * k, hand.neutral), None).base for k in range(500)]
    v, p = (np.array([getattr(each, name) for each in bases]) for name in ("v", "p"))
    np.testing.assert_array_equal(v[0], start.v)
    assert np.linalg.norm(np.diff(v, axis=0), axis=1).max() <= STOP_DECELERATION * PERIOD * (1.0 + 1e-9)
    np.testing.assert_allclose(np.diff(p, axis=0), 0.5 * PERIOD * (v[1:] + v[:-1]), rtol=0, atol=PERIOD**2)
    assert not v[-1].any()
    np.testing.assert_allclose(p[-1] - start.p, 0.5 * speed**2 / STOP_DECELERATION * direction, atol=1e-12)
