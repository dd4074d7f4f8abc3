"""Joint torques from currents: the inverse of the drives' law, and errors as large as their covariances say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp

from graspforce.contact.motion import BodyMotion
from graspforce.control.drives.drive_commands import DriveMap
from graspforce.core.errors import InvalidInput
from graspforce.estimation import GraspEstimator, Measurement, SensorModel
from graspforce.estimation.contact_forces import ForceModelErrors
from graspforce.estimation.current_torques import CurrentTorques
from graspforce.estimation.grasp_monitor import AppliedCommand, GraspMonitor
from graspforce.hand.drives.drive import Drive
from graspforce.hand.drives.joint_friction import JointFriction

DRIVE = Drive(mode="current", torque_constant=1.3, efficiency=0.8, backdriving_efficiency=0.7, torque_error=0.05)
COULOMB = 0.02  # N·m


def hand_with_currents(coulomb: float = 0.0):
    hand = three_finger_grasp().hand.with_drives(DRIVE)
    return replace(hand, friction=JointFriction(np.full(hand.n, coulomb), viscous=np.full(hand.n, coulomb)))


def test_gear_loses_power_in_both_directions():
    """While the motor drives, tau = η k i; while the joint drives it, tau = k i/η_b."""
    torques = CurrentTorques(hand_with_currents())
    current, fast = np.full(16, 0.1), np.full(16, 1.0)
    np.testing.assert_allclose(torques.torques(current, fast), 0.8 * 1.3 * current, rtol=1e-12)
    np.testing.assert_allclose(torques.torques(current, -fast), 1.3 * current / 0.7, rtol=1e-12)
    np.testing.assert_allclose(torques.torques(-current, fast), -1.3 * current / 0.7, rtol=1e-12)
    at_rest = torques.torques(current, 0.0 * fast)
    assert (at_rest > 0.8 * 1.3 * current).all()
    assert (at_rest < 1.3 * current / 0.7).all()


def test_currents_of_the_drives_give_back_the_torques_of_the_command():
    hand, rng = hand_with_currents(), np.random.default_rng(3)
    tau, v = rng.normal(0.0, 0.1, hand.n), rng.normal(0.0, 0.05, hand.n)
    command = DriveMap(hand).set_points(tau, three_finger_grasp().q, v)
    np.testing.assert_allclose(CurrentTorques(hand).torques(command.current, v), tau, rtol=1e-12)
    np.testing.assert_allclose(CurrentTorques(hand).currents(tau, v), command.current, rtol=1e-12)


def test_joint_friction_does_not_count_as_a_contact_force():
    hand, rng = hand_with_currents(COULOMB), np.random.default_rng(4)
    tau, v = rng.normal(0.0, 0.1, hand.n), rng.choice([-0.5, 0.5], hand.n)
    torques = CurrentTorques(hand)
    current = torques.currents(tau + COULOMB * np.sign(v) + COULOMB * v, v)
    np.testing.assert_allclose(torques.torques(current, v), tau, atol=1e-12)


def test_errors_of_the_torques_are_as_stated():
    """Random motors at rest: noise, torque constants, directions of the gears, and friction within its Coulomb torque."""
    hand, rng, noise = hand_with_currents(COULOMB), np.random.default_rng(5), 0.01
    torques, tau = CurrentTorques(hand), np.full(16, 0.2)
    stated, errors = torques.noise(noise), []
    for _ in range(2000):
        direction = rng.choice([-1.0, 1.0], hand.n)  # a rate below the resolution of the encoders
        friction, constant = rng.uniform(-COULOMB, COULOMB, hand.n), 1.0 + rng.uniform(-0.05, 0.05, hand.n)
        current = torques.currents(tau + friction, direction) / constant + noise * rng.normal(size=hand.n)
        errors.append(torques.torques(current, np.zeros(hand.n)) - tau)
    expected = np.sqrt(stated.noise**2 + stated.bias**2 + (stated.scale * tau) ** 2)
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (spread < expected).all()
    assert (spread > 0.5 * expected).all()  # the bounds are not far from the truth


def monitored_forces(sensors: SensorModel, noise: np.ndarray | None, seed: int = 0):
    """Return estimated forces at rest and their covariance, and the forces of exact torques."""
    given = three_finger_grasp()
    grasp, rng = replace(given, hand=hand_with_currents()), np.random.default_rng(seed)
    problem = grasp.force_problem(PALM_UP)
    f = rng.uniform(-0.3, 0.3, problem.contacts.size)  # N
    f[problem.contacts.normal_rows] = rng.uniform(1.0, 2.0, len(grasp.contacts))
    tau = problem.actuation.tau_u + problem.actuation.J.T @ f
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    found = []
    for each, error in ((sensors, noise), (SensorModel(torque_noise=1e-3), None)):
        estimator, monitor = GraspEstimator(grasp, each, 1e-3), GraspMonitor(grasp, each, 1e-3, PALM_UP)
        current = CurrentTorques(grasp.hand).currents(tau, np.zeros(grasp.hand.n)) + (0.0 if error is None else error)
        measured = {"tau": tau} if error is None else {"current": current}
        measurement = Measurement(0.0, grasp.q, **measured)
        estimate, memory = estimator.step(estimator.initial_memory(measurement), measurement)
        applied = AppliedCommand(np.zeros(grasp.hand.n), np.zeros(grasp.hand.n), rest)
        found.append(monitor.step(monitor.initial_memory(), measurement, estimate, memory, applied)[0].forces)
    return found


def test_monitor_takes_contact_forces_from_currents():
    by_current, by_torque = monitored_forces(SensorModel(current_noise=1e-3), np.zeros(16))
    np.testing.assert_allclose(by_current.f, by_torque.f, atol=2e-3 * np.abs(by_torque.f).max())


def test_normalised_errors_of_forces_from_currents_are_those_of_noise():
    """The squared error over the covariance of the noise is 9 on average, the number of components."""
    sensors, squares = SensorModel(current_noise=0.02), []
    for seed in range(60):
        noise = 0.02 * np.random.default_rng(100 + seed).normal(size=16)
        by_current, _ = monitored_forces(sensors, noise, seed)
        without, _ = monitored_forces(sensors, np.zeros(16), seed)
        error = (by_current.f - without.f).ravel()
        squares.append(error @ np.linalg.solve(by_current.noise, error))
    assert 0.3 * 9.0 < np.mean(squares) < 1.3 * 9.0  # the stated noise is that of the gear's best direction, and of the filter


def test_without_noise_of_currents_they_do_not_count():
    by_command, by_torque = monitored_forces(SensorModel(), np.zeros(16))
    assert np.abs(by_command.f - by_torque.f).max() > 0.05


def test_unknown_torque_constants_are_refused_by_joint():
    grasp = three_finger_grasp()
    with pytest.raises(InvalidInput, match=r"sensors\.current_noise.*joint_0"):
        GraspMonitor(grasp, SensorModel(current_noise=0.01), 1e-3, PALM_UP)
    assert CurrentTorques(hand_with_currents()).noise(0.01).added_to(ForceModelErrors(torque_bias=3.0)).torque_bias >= 3.0
