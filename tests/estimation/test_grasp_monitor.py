"""All estimators of contacts and payload in the loop: MuJoCo is the truth, which they never see."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.estimation import CameraModel, GraspEstimator, Measurement, PoseMeasurement, SensorModel
from graspforce.estimation.grasp_monitor import AppliedCommand, GraspMonitor
from graspforce.geometry.rotations import rotation_exp
from graspforce.grasp.body import Body

PERIOD = 1e-3  # s
LATE = 0.02  # s: age of the camera's poses


def run(sensors, duration, *, body=None, disturbances=(), seed=0):
    """Return estimates and true forces, in H, of a run at rest with the true state in the controller."""
    simulation = pytest.importorskip("graspforce.simulation")
    grasp, rng = three_finger_grasp(), np.random.default_rng(seed)
    plant = simulation.Plant(
        simulation.build_scene(grasp, gravity_H=PALM_UP, body=body),
        disturbances=tuple(make(simulation) for make in disturbances),
    )
    controller = ObjectController(grasp, ControlSettings(gravity_H=PALM_UP))
    state_estimator = GraspEstimator(grasp, sensors, PERIOD)
    monitor = GraspMonitor(grasp, sensors, PERIOD, PALM_UP)
    contact_memory = monitor.initial_memory()
    desired = BodyMotion(grasp.p_HO, grasp.R_HO)
    first = controller.step(plant.reset(), desired)
    controller.reset()
    state, memory, acceleration, images = plant.reset(first.f), None, np.zeros(grasp.hand.n), []
    results = []
    for k in range(round(duration / PERIOD)):
        t, contacts = k * PERIOD, plant.true_contacts()
        f_H = np.einsum("ij,njk,nk->ni", state.object.R_HO, contacts.R_OC, contacts.f[:, :3])
        q = state.q + sensors.encoder_noise * rng.normal(size=grasp.hand.n)
        tips = pose = None
        if sensors.tip_force_noise is not None:
            tips = np.pad(f_H + sensors.tip_force_noise * rng.normal(size=(3, 3)), ((0, 0), (0, 3)))
        if sensors.camera is not None and k % 33 == 0:
            R = rotation_exp(sensors.camera.angle_noise * rng.normal(size=3)) @ state.object.R_HO
            p = state.object.p_HO + sensors.camera.position_noise * rng.normal(size=3)
            images.append(PoseMeasurement(t, p, R))
        if images and images[0].t <= t - LATE:
            pose = images.pop(0)
        measurement = Measurement(t, q, tip_wrench=tips, object=pose)
        memory = memory or state_estimator.initial_memory(Measurement(t, state.q), 50)
        estimate, memory = state_estimator.step(memory, measurement, acceleration)
        applied = AppliedCommand(contacts.tau, acceleration, desired)
        estimate, contact_memory = monitor.step(contact_memory, measurement, estimate, memory, applied)
        in_H = np.einsum("ij,njk,nk->ni", memory.pose.R_HO, memory.pose.R_OC, estimate.forces.f)
        results.append((estimate, in_H - f_H))
        command = controller.step(state, desired)
        acceleration = command.joint_acceleration
        state = plant.step(command.tau)
    return results


TIPS = SensorModel(encoder_noise=1e-3, torque_noise=1e-3, tip_force_noise=0.02)
TORQUES = SensorModel(encoder_noise=1e-3, torque_noise=1e-3)
CAMERA = SensorModel(encoder_noise=1e-3, torque_noise=1e-3, camera=CameraModel(30.0, LATE, 1e-3, 0.02))


@cache
def run_at_rest(sensors):
    return run(sensors, 0.3)


@pytest.mark.parametrize("sensors", [TIPS, TORQUES, CAMERA])
def test_forces_are_within_their_covariance_and_nothing_slips(sensors):
    results = run_at_rest(sensors)
    errors = np.array([error for _, error in results[100:]])
    deviations = np.sqrt([estimate.forces.covariance.diagonal().mean() for estimate, _ in results[100:]])
    assert np.sqrt(np.mean(np.square(errors))) < 1.2 * deviations.mean()
    assert not any(estimate.slip.slipping.any() or estimate.slip.at_limit.any() for estimate, _ in results)
    assert np.isinf(results[-1][0].friction.upper).all()


def test_fingertip_sensors_halve_the_error_at_least():
    def error(sensors):
        return np.sqrt(np.mean(np.square([each for _, each in run_at_rest(sensors)[100:]])))

    assert error(TIPS) < 0.5 * error(TORQUES)


@pytest.mark.parametrize(("sensors", "duration"), [(TIPS, 0.4), (TORQUES, 1.0)])
def test_an_unknown_mass_is_found_within_a_second(sensors, duration):
    given = three_finger_grasp().body
    true = Body(1.7 * given.mass, 1.7 * given.inertia, given.p_OM, given.shape)
    payload = run(sensors, duration, body=true)[-1][0].payload
    assert abs(payload.mass / true.mass - 1.0) < 0.03
    assert abs(payload.mass - true.mass) < 3.0 * payload.mass_deviation


def test_late_images_give_no_false_alarm_and_find_slip():
    results = run(CAMERA, 0.4, disturbances=[lambda simulation: simulation.FrictionChange(0.05, 0.25)])
    slipping = np.array([estimate.slip.slipping.any() for estimate, _ in results])
    assert not slipping[:250].any()
    assert slipping[250:].any()


def bounds_after_slip(mu, finger, sensors, seed):
    """Return the last lower and upper bounds after the friction of a finger has fallen to μ, or of all."""
    change = lambda simulation: simulation.FrictionChange(mu, 0.15, 0.02, finger)  # noqa: E731
    results = run(sensors, 0.3, disturbances=[change], seed=seed)
    return np.array([[estimate.friction.lower, estimate.friction.upper] for estimate, _ in results[150:]])


def test_finite_bounds_of_friction_contain_the_truth_and_are_as_narrow_as_stated():
    """Twelve worlds in which the friction of one finger or of all falls; an infinite bound states no knowledge."""
    grasp, known = three_finger_grasp(), 0
    for seed, mu in enumerate(np.linspace(0.03, 0.25, 12)):
        finger = None if seed % 3 == 2 else grasp.fingers[seed % 3]
        lower, upper = bounds_after_slip(mu, finger, TIPS, seed).transpose(1, 0, 2)
        for i, name in enumerate(grasp.fingers):
            is_changed = finger in (None, name)
            finite = np.isfinite(upper[:, i])
            known += bool(finite.any())
            assert is_changed or not finite.any()  # a finger that sticks stays unbounded
            true = mu if is_changed else grasp.contacts.mu[i]
            assert (lower[finite, i] <= true).all()
            assert (upper[finite, i] >= true).all()
            # two deviations each way, of at most 15 % of the ratio or 0.025
            assert (upper - lower <= 4.0 * np.maximum(0.15 * 0.5 * (upper + lower), 0.025))[finite, i].all()
    assert known >= 4


def test_friction_stays_unbounded_without_fingertip_sensors():
    """In motion, the error of forces from torques exceeds 15 % of the ratio."""
    bounds = bounds_after_slip(0.1, None, TORQUES, 1)
    assert np.isinf(bounds[:, 1]).all()
