"""Phases of the held object: what its controller is told, and when a fingertip counts as lost."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from graspforce.control.phases.cycle_plan import BaseMotion, place_profile
from graspforce.control.phases.finger_servo import ServoStep
from graspforce.control.phases.object_phases import CarryPhase, GraspWatch, HeldObject, SqueezePhase
from graspforce.control.phases.phase_rules import LOST_CONTACT, MOVED
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.release_phase import ReleasePhase
from graspforce.control.phases.tip_motion import TipMotion
from graspforce.estimation.measurement import Measurement, PoseMeasurement
from tests.support.table_scenes import ball_scene

PERIOD = 1e-3  # s
SETTINGS = PhaseSettings(contact_tolerance=4e-3, loss_time=0.1)


class RecordingController:
    """Controller that keeps its measurements, with a given estimate."""

    def __init__(self, gap=(0.0, 0.0, 0.0)):
        self.measurements = []
        self.estimate = SimpleNamespace(gap=np.array(gap))

    def step(self, measurement, desired, external=None):
        self.measurements.append(measurement)
        return SimpleNamespace(forces_reused=False)


def held_object(controller: RecordingController, gaps=(0.0, 0.0, 0.0)) -> HeldObject:
    scene, servo = ball_scene(), SimpleNamespace(period=PERIOD)
    return HeldObject(scene.grasp, controller, servo, scene.gravity_H, SETTINGS, np.array(gaps))


def loss_time(held: HeldObject) -> float:
    """Return the time until the watch finds a lost contact, s; infinite if it finds none within a second."""
    watch = GraspWatch(held)
    for k in range(1000):
        if watch.abort_reason(SimpleNamespace(forces_reused=False)) == LOST_CONTACT:
            return k * PERIOD
    return np.inf


class RunningServo:
    """Servo whose first fingertip moves along its inward normal with a speed, m/s."""

    period = PERIOD

    def __init__(self, speed: float) -> None:
        grasp = ball_scene().grasp
        normals = grasp.contacts.R_OC[:, :, 2] @ grasp.R_HO.T
        self._q, self.speed = grasp.q, speed
        _, self._rates = TipMotion(grasp.hand, grasp.fingers).advance(grasp.q, np.array([[1.0], [0.0], [0.0]]) * normals, 1e-6)

    def step(self, memory, measurement, desired, bounds, *, is_free=False, learns=True, predicted=True):
        v, none = self.speed * self._rates, np.zeros((3, 3))
        return ServoStep(np.zeros(len(v)), self._q, v, none, none, none), memory


def squeezed_object(servo) -> HeldObject:
    """Return a held object whose controller estimates it where the fingers touched it."""
    scene, controller = ball_scene(), RecordingController()
    controller.step = lambda measurement, desired, external=None: SimpleNamespace(forces_reused=False, tau=np.ones(16))
    controller.estimate.object = SimpleNamespace(p_HO=scene.grasp.p_HO, R_HO=scene.grasp.R_HO)
    return HeldObject(scene.grasp, controller, servo, scene.gravity_H, SETTINGS, np.zeros(3))


def test_squeeze_goes_back_while_a_fingertip_runs_towards_the_object():
    """A finger that rushes to the object would hit it with more than the planned force."""
    servo, scene = RunningServo(0.0), ball_scene()
    phase = SqueezePhase(squeezed_object(servo), scene.grasp.q, BaseMotion.at_rest(np.zeros(3)))

    def shares(speed: float, count: int) -> np.ndarray:
        servo.speed = speed
        return np.array([phase.step(0.0, Measurement(0.0, scene.grasp.q), None).share for _ in range(count)])

    rising = shares(0.02, 200)
    assert (np.diff(rising) > 0.0).all()
    assert (np.diff(shares(0.1, 15)) < 0.0).all()  # ten times as fast: a tip gains 0.1 m/s within 50 ms
    assert shares(0.1, 100)[-1] == 0.0
    again = shares(0.02, 1000)
    assert again[:200] == pytest.approx(rising)
    assert again[-1] == 1.0


def correlated_noise(count: int, steps: float, rng: np.random.Generator) -> np.ndarray:
    """Return noise with standard deviation 1 whose correlation falls to 1/e within some steps."""
    kept, noise = math.exp(-1.0 / steps), np.zeros(count)
    for k in range(1, count):
        noise[k] = kept * noise[k - 1] + math.sqrt(1.0 - kept**2) * rng.standard_normal()
    return noise


def test_noise_of_the_rates_does_not_stop_the_squeeze():
    """Tip speeds from noisy encoders exceed 30 mm/s in a tenth of the periods, with a correlation over 3 ms."""
    servo, scene, rng = RunningServo(0.0), ball_scene(), np.random.default_rng(3)
    phase = SqueezePhase(squeezed_object(servo), scene.grasp.q, BaseMotion.at_rest(np.zeros(3)))
    count = round((SETTINGS.squeeze_time + SETTINGS.transfer_time) / PERIOD)
    speeds = 0.024 * correlated_noise(2 * count, 3.0, rng)  # m/s
    assert (speeds > 0.03).mean() > 0.08
    for speed in speeds:
        servo.speed = speed
        result = phase.step(0.0, Measurement(0.0, scene.grasp.q), None)
    assert result.is_over


@pytest.mark.parametrize("direction", np.eye(3).tolist())
def test_squeeze_ends_when_the_fingers_push_the_object_away(direction):
    scene = ball_scene()
    held = squeezed_object(RunningServo(0.0))
    phase = SqueezePhase(held, scene.grasp.q, BaseMotion.at_rest(np.zeros(3)))
    for shift, reason in ((0.0, ""), (0.9, ""), (1.1, MOVED), (-1.1, MOVED), (-0.9, "")):
        p = scene.grasp.p_HO + shift * SETTINGS.largest_shift * np.array(direction)
        held.controller.estimate.object = SimpleNamespace(p_HO=p, R_HO=scene.grasp.R_HO)
        assert phase.step(0.0, Measurement(0.0, scene.grasp.q), None).abort == reason


def test_released_fingers_open_to_the_pregrasp_posture_with_the_opening_speed():
    scene, rng = ball_scene(), np.random.default_rng(0)
    grasp, desired = scene.grasp, []
    q_open = np.clip(grasp.q + 0.1 * rng.standard_normal(16), grasp.hand.q_lower, grasp.hand.q_upper)

    class Servo(RunningServo):
        def step(self, memory, measurement, wanted, bounds, **options):
            desired.append(wanted)
            return super().step(memory, measurement, wanted, bounds, **options)

    phase = ReleasePhase(squeezed_object(Servo(0.0)), grasp.q, BaseMotion.at_rest(np.zeros(3)), q_open)
    times = PERIOD * np.arange(3000)
    over = next(t for t in times if phase.step(float(t), Measurement(float(t), grasp.q), None).is_over)
    waiting = [each for t, each in zip(times, desired, strict=False) if t < SETTINGS.squeeze_time]
    assert all((each.q == grasp.q).all() for each in waiting)
    assert desired[-1].q == pytest.approx(q_open, abs=1e-9)
    tips = TipMotion(grasp.hand, grasp.fingers)
    distance = np.linalg.norm(tips.positions(q_open) - tips.positions(grasp.q), axis=1).max()  # m
    assert over - SETTINGS.squeeze_time == pytest.approx(distance / SETTINGS.open_speed, abs=2 * PERIOD)


def touch_target(rise: float, at: float, lowers: bool = True) -> float:
    """Return how far the target has followed an object that rises in the hand, as a part of its rise.

    Args:
        rise: of the object, m.
        at: way of the base before the end of its motion at which it rises, m.
        lowers: whether the base lowers the object to the table.
    """
    scene, lift = ball_scene(), 0.05  # m
    controller, wanted = RecordingController(), []
    servo = SimpleNamespace(period=PERIOD, observe=lambda memory, measurement: (SimpleNamespace(q=scene.grasp.q), memory))

    def step(measurement, desired, external=None):
        wanted.append(desired)
        return SimpleNamespace(forces_reused=False, tau=np.zeros(16))

    controller.step = step
    controller.estimate.object = SimpleNamespace(p_HO=scene.grasp.p_HO, R_HO=scene.grasp.R_HO)
    held = HeldObject(scene.grasp, controller, servo, scene.gravity_H, SETTINGS, np.zeros(3))
    profile = place_profile(lift)
    phase = CarryPhase(held, -lift * scene.down, lift * scene.down, profile, lowers)
    for k in range(round(profile.duration / PERIOD) - 1):
        if lift * (1.0 - profile(k * PERIOD)[0]) < at:
            risen = scene.grasp.p_HO - rise * scene.down
            controller.estimate.object = SimpleNamespace(p_HO=risen, R_HO=scene.grasp.R_HO)
        phase.step(k * PERIOD, Measurement(k * PERIOD, scene.grasp.q), None)
    return float((wanted[-1].p_HO - scene.grasp.p_HO) @ -scene.down) / rise


def test_target_follows_an_object_that_the_table_pushes_up():
    """An object that hangs low meets the table early; with a fixed target the hand would press it down."""
    assert touch_target(2e-3, at=8e-3) == pytest.approx(1.0, abs=1e-3)
    assert touch_target(2e-3, at=8e-3, lowers=False) == 0.0


def test_scatter_and_sinking_of_a_carried_object_are_not_taken_for_the_table():
    """Estimates scatter by less than 0.5 mm."""
    assert touch_target(4e-4, at=8e-3) == 0.0
    for k in range(3):
        assert touch_target(-2e-3, at=1e-2 * k) == 0.0  # it sinks


def test_camera_does_not_move_a_held_object():
    """The pose from the touch and that of a camera differ; the object stays where the fingers took it."""
    controller = RecordingController()
    held = held_object(controller)
    grasp = held.grasp
    seen = PoseMeasurement(0.0, grasp.p_HO + 0.01, grasp.R_HO)
    held.step(Measurement(0.0, grasp.q, object=seen), 1.0, BaseMotion.at_rest(np.zeros(3)))
    held.step(Measurement(PERIOD, grasp.q), 1.0, BaseMotion.at_rest(np.zeros(3)))
    assert [each.object for each in controller.measurements] == [None, None]
    assert [each.t for each in controller.measurements] == [0.0, PERIOD]


@pytest.mark.parametrize(
    ("gap", "at_touch", "expected"),
    [
        (0.003, 0.0, np.inf),  # within the tolerance
        (0.005, 0.0, SETTINGS.loss_time),
        (0.008, 0.005, np.inf),  # 3 mm further than at the touch
        (0.010, 0.005, SETTINGS.loss_time),
        (0.005, -0.005, SETTINGS.loss_time),  # a fingertip inside the modelled surface has no more room
    ],
)
def test_fingertip_is_lost_when_it_leaves_its_place_at_the_touch(gap, at_touch, expected):
    held = held_object(RecordingController((0.0, gap, 0.0)), (0.0, at_touch, 0.0))
    assert loss_time(held) == pytest.approx(expected, abs=2 * PERIOD)


def test_torques_with_those_of_the_accelerated_links_keep_the_limits():
    hand, base = ball_scene().grasp.hand, BaseMotion(np.zeros(3), np.zeros(3), np.array([3.0, -2.0, 5.0]))
    held, q = held_object(RecordingController()), ball_scene().grasp.q
    inertial = hand.gravity_torque(q, -base.a)
    zero = SimpleNamespace(tau=np.zeros(hand.n))
    np.testing.assert_allclose(held.torque(zero, q, base), inertial)  # within the limits
    for bound in (hand.torque_lower, hand.torque_upper):
        tau = held.torque(SimpleNamespace(tau=0.999 * bound), q, base)
        assert ((tau >= hand.torque_lower) & (tau <= hand.torque_upper)).all()
        np.testing.assert_allclose(tau, np.clip(0.999 * bound + inertial, hand.torque_lower, hand.torque_upper))
        assert (tau == bound).any()
