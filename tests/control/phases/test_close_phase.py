"""The guarded close of fingers that stop off the object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graspforce.control.phases.close_phase import ClosePhase
from graspforce.control.phases.contact_detector import ContactDetector
from graspforce.control.phases.cycle_plan import BaseMotion, CyclePlan
from graspforce.control.phases.finger_servo import ForceBounds, ServoMemory, ServoStep
from graspforce.control.phases.phase_rules import NO_CONTACT
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.tip_motion import TipMotion
from graspforce.control.phases.touched_grasp import touch_gaps
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.sensor_model import SensorModel
from graspforce.hand.hand import Hand
from graspforce.simulation.cycle.plan_cycle import CycleMotion, plan_cycle
from tests.support.table_scenes import ball_scene

PERIOD, SETTINGS = 1e-3, PhaseSettings(close_speed=0.05)
STUCK = 0.01  # m before its contact, where the first finger sticks


@pytest.fixture(scope="module")
def plan() -> CyclePlan:
    return plan_cycle(ball_scene(), SETTINGS, CycleMotion(optimised=False))


class StickingServo:
    """Servo whose tips follow their targets up to the ball; the first one sticks before, up to a force along its normal.

    Args:
        plan: the plan.
        force: largest force at which the first finger sticks, N.
        stuck: distance before its contact where it sticks, m.
    """

    period = PERIOD

    def __init__(self, plan: CyclePlan, force: float, stuck: float = STUCK) -> None:
        grasp = plan.grasp
        self._grasp, self._force, self._stuck, self._is_loose = grasp, force, stuck, False
        self._normals = grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T
        self._touch = np.array([grasp.hand.tip_pose(grasp.q, name)[0] for name in grasp.fingers])

    def step(self, memory, measurement, desired, bounds, *, is_free=False):
        hand, fingers = self._grasp.hand, self._grasp.fingers
        targets = np.array([hand.tip_pose(desired.q, name)[0] for name in fingers])
        ahead = np.einsum("ij,ij->i", targets - self._touch, self._normals)  # m
        room = np.zeros(len(fingers))
        bound = (bounds.along if isinstance(bounds, ForceBounds) else bounds)[0]
        self._is_loose |= bool(ahead[0] > -self._stuck and bound > self._force)
        if not self._is_loose:
            room[0] = -self._stuck
        p_tip = targets - np.maximum(ahead - room, 0.0)[:, None] * self._normals
        none = np.zeros((len(fingers), 3))
        return ServoStep(np.zeros(hand.n), desired.q, np.zeros(hand.n), p_tip, none, none), memory


class PassingServo(StickingServo):
    """As `StickingServo`, but the first tip passes beside the ball once it is loose. It keeps the bounds and the touches."""

    def __init__(self, plan: CyclePlan, force: float) -> None:
        super().__init__(plan, force)
        self.normals, self.touching, self.bounds = self._normals, np.zeros(len(self._touch), dtype=bool), []

    def step(self, memory, measurement, desired, bounds, *, is_free=False):
        bound = float((bounds.along if isinstance(bounds, ForceBounds) else bounds)[0])
        if isinstance(bounds, ForceBounds) and bound not in self.bounds:
            self.bounds.append(bound)
        servo, memory = super().step(memory, measurement, desired, bounds, is_free=is_free)
        ahead = np.einsum("ij,ij->i", servo.p_tip - self._touch, self.normals)  # m
        self.touching = ahead > -1e-9
        if not self._is_loose:
            return servo, memory
        target = self._grasp.hand.tip_pose(desired.q, self._grasp.fingers[0])[0]
        return replace(servo, p_tip=np.vstack([target, servo.p_tip[1:]])), memory


def close(plan: CyclePlan, force: float, stuck: float = STUCK) -> tuple[bool, str, np.ndarray]:
    """Return whether the close ends, why it aborts, and the gaps at its end, m."""
    hand = plan.grasp.hand
    servo, detector = StickingServo(plan, force, stuck), ContactDetector(hand, SensorModel(), SETTINGS, PERIOD)
    phase = ClosePhase(servo, detector, plan, SETTINGS, BaseMotion.at_rest(np.zeros(3)))
    memory = ServoMemory(None, np.zeros(hand.n), np.full(hand.n, 0.05))
    for k in range(3000):
        result = phase.step(k * PERIOD, Measurement(k * PERIOD, plan.q_pregrasp), memory)
        if result.is_over or result.abort:
            break
    return result.is_over, result.abort, touch_gaps(plan.grasp, result.servo[0].p_tip)


def close_without_touch(plan: CyclePlan, sticks: bool) -> tuple[ClosePhase, str, list[float]]:
    """Return the phase in which a tip never touches, why it aborts, and the different bounds of this tip's feedback, N.

    Force sensors show the contacts of the other tips. This tip sticks halfway, or passes beside the object.
    """
    hand, count = plan.grasp.hand, len(plan.grasp.fingers)
    servo = PassingServo(plan, 1e3 if sticks else 0.0)
    detector = ContactDetector(hand, SensorModel(tip_force_noise=1e-3), SETTINGS, PERIOD)
    phase = ClosePhase(servo, detector, plan, SETTINGS, BaseMotion.at_rest(np.zeros(3)))
    memory, wrench = ServoMemory(None, np.zeros(hand.n), np.full(hand.n, 0.05)), np.zeros((count, 6))
    for k in range(10000):
        result = phase.step(k * PERIOD, Measurement(k * PERIOD, plan.q_pregrasp, tip_wrench=wrench), memory)
        wrench[1:, :3] = servo.touching[1:, None] * servo.normals[1:]  # N
        if result.is_over or result.abort:
            break
    return phase, result.abort, servo.bounds


def new_phase(plan: CyclePlan) -> ClosePhase:
    """Return the phase of fingers that never stick."""
    detector = ContactDetector(plan.grasp.hand, SensorModel(), SETTINGS, PERIOD)
    return ClosePhase(StickingServo(plan, 0.0), detector, plan, SETTINGS, BaseMotion.at_rest(np.zeros(3)))


def largest_bound(plan: CyclePlan) -> float:
    """Return the bound of the first finger before it is raised, N."""
    n = plan.grasp.hand.n
    return float(new_phase(plan)._bound(ServoMemory(None, np.zeros(n), np.full(n, 0.05)), 0.3)[0])


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_finger_that_sticks_off_the_object_goes_on_until_it_touches(plan, factor):
    """A finger that stops 10 mm early does not fit the ball of the others; with twice the bound it breaks loose."""
    is_over, abort, gaps = close(plan, factor * largest_bound(plan))
    assert is_over, abort
    assert np.abs(gaps).max() < 1e-3


def test_close_ends_with_a_finger_that_never_breaks_loose(plan):
    """The controller then compares the touched places with the object, and stops."""
    is_over, abort, gaps = close(plan, 1e3)
    assert is_over, abort
    assert gaps[0] == pytest.approx(STUCK, abs=1e-3)


def test_finger_that_sticks_where_the_object_cannot_be_does_not_count_as_touching(plan):
    """Until it leaves the pre-grasp posture its bound is 5 N; if that is too small, the close does not end."""
    stuck = float(plan.standoff[0])  # m
    is_over, abort, gaps = close(plan, 4.9, stuck)
    assert is_over, abort
    assert np.abs(gaps).max() < 1e-3
    assert not close(plan, 5.1, stuck)[0]


def test_finger_that_sticks_without_a_sign_of_contact_goes_on_with_a_larger_bound(plan):
    phase, abort, bounds = close_without_touch(plan, sticks=True)
    assert abort == NO_CONTACT
    force = SETTINGS.touch_force
    assert max(bounds) - force > 3.5 * (min(bounds) - force)  # N: twice the share of the friction, two times
    assert phase.signs == ("", "tip force", "tip force")
    assert not phase.has_passed.any()


def test_finger_that_passes_beside_the_object_does_not_push_harder(plan):
    phase, abort, bounds = close_without_touch(plan, sticks=False)
    assert abort == NO_CONTACT
    assert max(bounds) < 1.5 * min(bounds)  # the bound varies with the posture
    assert phase.has_passed.tolist() == [True, False, False]


def test_target_has_the_commanded_speed_if_it_follows_its_normal(plan):
    hand, speed = plan.grasp.hand, SETTINGS.close_speed
    phase = new_phase(plan)
    normals = plan.grasp.contacts.R_OC[:, :, 2] @ plan.grasp.R_HO.T
    commanded = np.array([speed, 0.0, speed])
    _, rates = TipMotion(hand, plan.grasp.fingers).advance(plan.q_pregrasp, commanded[:, None] * normals, PERIOD)
    assert phase._target_speeds(commanded, rates).tolist() == commanded.tolist()
    slow = phase._target_speeds(commanded, 0.45 * rates)
    assert slow == pytest.approx(0.5 * commanded, rel=0.02)  # 0.45 of 0.9, from which a target counts as following
    assert not phase._target_speeds(commanded, np.zeros(hand.n)).any()
    assert not phase._target_speeds(commanded, -rates).any()


@pytest.mark.parametrize("angle", [0.0, 30.0, 50.0, 65.0])
def test_target_of_a_finger_of_one_joint_is_as_slow_as_its_tip(angle):
    """The tip of a parallel jaw moves along its rail; the component of its motion along a normal has the share cos²."""
    hand = Hand.load("parallel_jaws")
    motion = TipMotion(hand, ("left",))
    rail = motion.velocities(hand.neutral, np.ones(hand.n))[0]
    rail /= np.linalg.norm(rail)
    across = np.cross(rail, [0.6, 0.0, 0.8])
    across /= np.linalg.norm(across)
    n = np.cos(np.radians(angle)) * rail + np.sin(np.radians(angle)) * across
    _, rates = motion.advance(0.5 * (hand.q_lower + hand.q_upper), 0.02 * n[None], PERIOD)
    speed = motion.velocities(hand.neutral, rates)[0] @ n
    assert speed == pytest.approx(0.02 * np.cos(np.radians(angle)) ** 2, rel=1e-3)
