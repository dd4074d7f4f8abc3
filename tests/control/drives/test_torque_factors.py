"""Learned errors of the drives: the integral moves along with the torques, and the errors converge to the true ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.hands import load
from support.simulated_runs import start_of

from graspforce.control import ControlSettings, OutputFeedbackController
from graspforce.control.drives.torque_factors import TorqueFactorEstimator, TorqueFactors, null_space_part
from graspforce.core.errors import InvalidInput
from graspforce.estimation import SensorModel
from graspforce.hand.drives.drive import Drive
from graspforce.simulation import World, linear_reference, make_world_plant, simulate_measured

N = 12
GAIN = np.full(6, 5e4)  # 1/s³
HAND = load("four_finger")
DRIVE = Drive("current", torque_constant=1.0, torque_error=0.2)
ESTIMATOR = TorqueFactorEstimator(HAND.with_drives(DRIVE), GAIN, 1e-3)
STILL = np.zeros(HAND.n)


def random_sensitivity(rng: np.random.Generator) -> np.ndarray:
    """Return accelerations per torque, m/s² and rad/s² per N·m."""
    return rng.standard_normal((6, N)) * np.repeat([10.0, 300.0], 3)[:, None]


def test_integral_stays_while_the_torques_do() -> None:
    rng = np.random.default_rng(1)
    S, tau, factors = random_sensitivity(rng), rng.uniform(-0.5, 0.5, N), None
    for _ in range(5):
        given = 1e-5 * rng.standard_normal(6)
        before = factors
        factors, integral = ESTIMATOR.step(factors, S, tau, given, STILL)
        np.testing.assert_allclose(integral, given, rtol=0.0, atol=1e-18)
    assert before is not None


def test_integral_changes_by_the_learned_part_when_the_torques_change() -> None:
    rng = np.random.default_rng(2)
    S, tau, given = random_sensitivity(rng), rng.uniform(-0.5, 0.5, N), 1e-5 * rng.standard_normal(6)
    factors, integral = ESTIMATOR.step(None, S, tau, given, STILL)
    _, moved = ESTIMATOR.step(factors, S, 1.3 * tau, integral, STILL)
    np.testing.assert_allclose(moved - integral, 0.3 * (S * tau) @ factors.errors / GAIN, rtol=1e-9)


def test_errors_converge_to_those_of_the_drives() -> None:
    rng = np.random.default_rng(3)
    true = rng.uniform(-0.2, 0.2, N)
    S, first, factors = random_sensitivity(rng), rng.uniform(-0.5, 0.5, N), None
    for _ in range(2000):
        tau = first + rng.uniform(-0.2, 0.2, N)
        integral = (S * tau) @ true / GAIN if factors is None else needed(factors, S, tau, true)
        factors, _ = ESTIMATOR.step(factors, S, tau, integral, STILL)
    np.testing.assert_allclose(factors.errors, true, atol=1e-3)


def needed(factors: TorqueFactors, S: np.ndarray, tau: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return the integral before a step that after it opposes the true errors."""
    return (S * tau) @ (true - factors.errors) / GAIN + factors.integral


def test_errors_stay_within_the_stated_ones() -> None:
    rng = np.random.default_rng(4)
    drives = [replace(DRIVE, torque_error=0.05 * (i % 2)) for i in range(N)]
    hand = HAND.with_drives(drives)
    S, tau, integral = random_sensitivity(rng), rng.uniform(-0.5, 0.5, N), 1e-2 * rng.standard_normal(6)
    factors, _ = TorqueFactorEstimator(hand, GAIN, 1e-3).step(None, S, tau, integral, STILL)
    assert (np.abs(factors.errors) <= hand.drives.values("torque_error")).all()
    assert factors.errors[0] == 0.0


def test_posture_moves_against_its_drift_up_to_half_the_joint_range() -> None:
    drift, factors = np.linspace(-0.1, 0.1, N), None
    for _ in range(10):
        factors, _ = ESTIMATOR.step(factors, np.zeros((6, N)), STILL, np.zeros(6), drift)
    np.testing.assert_allclose(factors.posture, 10 * 5.0 * 1e-3 * drift)
    factors, _ = ESTIMATOR.step(factors, np.zeros((6, N)), STILL, np.zeros(6), 1e6 * drift)
    np.testing.assert_allclose(np.abs(factors.posture), 0.5 * (HAND.q_upper - HAND.q_lower))


def test_null_space_part_moves_no_contact() -> None:
    rng = np.random.default_rng(7)
    A, e = rng.standard_normal((5, N)), rng.standard_normal(N)
    part = null_space_part(A, e, 1e-6)
    np.testing.assert_allclose(A @ part, 0.0, atol=1e-12)
    np.testing.assert_allclose(null_space_part(A, part, 1e-6), part, atol=1e-12)
    assert np.linalg.norm(part) > 0.1


@pytest.mark.parametrize(("error", "gain", "is_active"), [(0.2, GAIN, True), (0.0, GAIN, False), (0.2, 0.0 * GAIN, False)])
def test_estimate_needs_stated_errors_and_an_integral(error: float, gain: np.ndarray, is_active: bool) -> None:
    hand = HAND.with_drives(replace(DRIVE, torque_error=error))
    assert TorqueFactorEstimator(hand, gain, 1e-3).is_active is is_active


def test_record_round_trip_and_its_errors() -> None:
    factors = TorqueFactors(np.arange(3.0), np.arange(6.0), np.arange(3.0))
    again = TorqueFactors.from_dict(factors.to_dict())
    np.testing.assert_array_equal(again.errors, factors.errors)
    np.testing.assert_array_equal(again.integral, factors.integral)
    np.testing.assert_array_equal(again.posture, factors.posture)
    with pytest.raises(InvalidInput, match=r"memory\.torque_factors\.integral"):
        TorqueFactors.from_dict({"errors": [0.0], "integral": [1.0], "posture": [0.0]}, "memory.torque_factors")


def test_shift_moves_the_posture_only_and_names_an_estimate_of_another_hand() -> None:
    grasp = three_finger_grasp()
    n, rest = grasp.hand.n, start_of(grasp)
    factors = TorqueFactors(np.zeros(n), np.zeros(6), np.linspace(0.0, 0.1, n))
    shifted = factors.shift(rest, grasp.q)
    np.testing.assert_array_equal(shifted.q, grasp.q + factors.posture)
    assert shifted.object is rest
    assert not shifted.v.any()
    with pytest.raises(InvalidInput, match=r"memory\.torque_factors\.errors"):
        TorqueFactors(np.zeros(2), np.zeros(6), np.zeros(2)).shift(rest, grasp.q)


def moved_error(drive: Drive, world: World) -> float:
    """Return the RMS distance from a motion of 5 mm at 1 Hz in its second half, m."""
    grasp = three_finger_grasp()
    grasp = replace(grasp, hand=grasp.hand.with_drives(drive))
    base = ControlSettings(gravity_H=PALM_UP, slip_margin=0.5)
    settings = ControlSettings.for_sensors(world.sensors, base, drives=grasp.hand.drives).settings
    controller = OutputFeedbackController(grasp, settings, world.sensors)
    plant = make_world_plant(world, grasp, PALM_UP)
    reference = linear_reference(start_of(grasp), [0.0, 0.0, 0.005], 1.0)
    run = simulate_measured(plant, controller, reference, 1.6, world)
    return float(np.sqrt(np.mean(np.sum(run.motion_error[800:] ** 2, axis=1))))


def test_servos_with_wrong_stiffness_move_the_object_like_torque_drives() -> None:
    sensors = SensorModel(encoder_noise=1e-4)
    servo = Drive("position", stiffness=5.0, damping=0.05, stiffness_error=0.3, beyond_limits=0.2)
    wrong = moved_error(servo, World(sensors=sensors, stiffness_error=0.3, seed=5))
    assert wrong <= 3.0 * moved_error(Drive(), World(sensors=sensors, seed=5))
