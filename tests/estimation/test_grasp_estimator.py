"""The estimator in the loop: MuJoCo is the truth, which the estimator never sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.control_grasps import named_grasp
from support.rolling_motion import pose_errors, rolling_samples, smooth_motion

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController
from graspforce.core.errors import InvalidInput
from graspforce.estimation import CameraModel, GraspEstimator, Measurement, PoseMeasurement, SensorModel
from graspforce.estimation.pose.pose_fusion import PoseOffset

PERIOD = 1e-3  # s


def control_from_estimate(sensors, duration, travel, *, camera=None, seed=0, delay=0):
    """Run the three-finger grasp in MuJoCo with joint positions only; return true errors of control and of estimation, m."""
    simulation = pytest.importorskip("graspforce.simulation")
    grasp, settings, rng = three_finger_grasp(), ControlSettings(gravity_H=PALM_UP), np.random.default_rng(seed)
    plant = simulation.Plant(simulation.build_scene(grasp, gravity_H=PALM_UP))
    controller, estimator = ObjectController(grasp, settings), GraspEstimator(grasp, sensors, PERIOD)
    start = BodyMotion(grasp.p_HO, grasp.R_HO)
    reference = simulation.linear_reference(start, travel, 1.0)
    first = controller.step(plant.reset(), start)
    controller.reset()
    state, memory, acceleration, torques = plant.reset(first.f), None, None, [first.tau] * delay
    errors, estimate_errors = [], []
    for k in range(round(duration / PERIOD)):
        t = k * PERIOD
        q = state.q + sensors.encoder_noise * rng.normal(size=grasp.hand.n)
        measurement = Measurement(t, q, object=None if camera is None else camera(t, state.object, rng))
        memory = memory or estimator.initial_memory(measurement)
        estimate, memory = estimator.step(memory, measurement, acceleration)
        desired = reference(estimate.t)
        desired = estimate.to_contact_frame(desired) if camera is not None else desired
        command = controller.step(GraspState(estimate.q, estimate.v, estimate.object), desired)
        acceleration = command.joint_acceleration
        errors.append(np.linalg.norm(state.object.p_HO - reference(t).p_HO))
        estimate_errors.append(np.linalg.norm(estimate.fused_pose.p_HO - state.object.p_HO))
        torques.append(command.tau)
        state = plant.step(torques.pop(0))
    return np.array(errors), np.array(estimate_errors)


def rms(x):
    return np.sqrt(np.mean(np.square(x)))


def test_joint_positions_alone_hold_the_object_still():
    errors, estimate_errors = control_from_estimate(SensorModel(), 0.2, np.zeros(3))
    assert errors.max() < 5e-6  # the object's weight rests on soft contacts: µm
    assert estimate_errors.max() < 5e-6


def test_joint_positions_alone_follow_a_motion():
    errors, estimate_errors = control_from_estimate(SensorModel(), 0.6, [0.0, -0.005, 0.0])
    assert rms(errors) < 2e-5
    assert rms(estimate_errors) < 2e-5


def test_noisy_joint_positions_hold_the_object():
    errors, _ = control_from_estimate(SensorModel(encoder_noise=1e-3), 0.6, [0.0, -0.005, 0.0])
    assert errors.max() < 1e-3  # 1 mrad displaces a fingertip by about 0.1 mm


def test_a_known_delay_of_the_loop_is_predicted():
    errors, _ = control_from_estimate(SensorModel(encoder_noise=1e-5, latency=0.01), 0.4, [0.0, -0.005, 0.0], delay=10)
    assert rms(errors) < 1e-4


def late_camera(model, lost):
    """Return a camera as a function of time: images at the rate of the model, which arrive late."""
    waiting = []

    def image(t, motion, rng):
        if round(t / PERIOD) % round(1.0 / (model.rate * PERIOD)) == 0 and not lost[0] <= t < lost[1]:
            turn = Rotation.from_rotvec(model.angle_noise * rng.normal(size=3)).as_matrix()
            p = motion.p_HO + model.position_noise * rng.normal(size=3)
            waiting.append((t + model.latency, PoseMeasurement(t, p, turn @ motion.R_HO)))
        return waiting.pop(0)[1] if waiting and waiting[0][0] <= t else None

    return image


def test_a_late_noisy_camera_that_is_lost_for_a_while_does_not_disturb():
    """The first images weigh as much as the start, which is known to 1 mm: the object moves by a part of their noise."""
    model = CameraModel(30.0, 0.05, 1e-3, 0.0175)
    sensors, camera = SensorModel(encoder_noise=1e-4, camera=model), late_camera(model, lost=(0.3, 0.7))
    errors, estimate_errors = control_from_estimate(sensors, 0.9, [0.0, -0.005, 0.0], camera=camera)
    assert errors.max() < 2e-3
    assert rms(estimate_errors) < 1e-3


# ── without a plant ─────────────────────────────────────────────────────────────────────────────────────────────────────────


def estimate_samples(estimator, samples, sigma=0.0, seed=0, **options):
    """Return the estimates of rolling samples with encoder noise."""
    rng, n = np.random.default_rng(seed), len(samples[0].q)
    measured = [Measurement(sample.t, sample.q + sigma * rng.normal(size=n)) for sample in samples]
    memory, estimates = estimator.initial_memory(measured[0]), []
    for measurement in measured:
        estimate, memory = estimator.step(memory, measurement, **options)
        estimates.append(estimate)
    return estimates, memory


def test_rolling_motion_is_estimated_from_exact_joint_positions():
    grasp = named_grasp("four_finger box")
    samples = rolling_samples(
        grasp, smooth_motion(grasp, np.array([0.002, -0.004, 0.003]), np.array([0.1, 0.05, -0.15]), 1.0), 0.3, PERIOD
    )
    estimates, _ = estimate_samples(GraspEstimator(grasp), samples)
    for sample, estimate in zip(samples, estimates, strict=True):
        position, angle = pose_errors(estimate.object, sample.object)
        assert position < 1e-8
        assert angle < 1e-6
        np.testing.assert_array_equal(estimate.fused_pose.p_HO, estimate.object.p_HO)


def test_pose_errors_from_encoder_noise_are_as_large_as_the_covariance_says():
    """Over independent runs of a rolling motion, the normalised squared errors follow a chi-square distribution.

    They are smaller in part: this hand starts at rest, and the filter counts on rates of 0.05 rad/s at the start.
    """
    grasp, sigma, runs, squares = three_finger_grasp(), 5e-4, 40, []
    samples = rolling_samples(grasp, smooth_motion(grasp, np.array([0.001, -0.003, 0.002]), np.zeros(3), 1.0), 0.12, PERIOD)
    estimator = GraspEstimator(grasp, SensorModel(encoder_noise=sigma))
    for seed in range(runs):
        estimate, true = estimate_samples(estimator, samples, sigma, seed)[0][-1], samples[-1].object
        turn = Rotation.from_matrix(estimate.object.R_HO @ true.R_HO.T).as_rotvec()
        error = np.append(estimate.object.p_HO - true.p_HO, turn)
        squares.append(error @ np.linalg.solve(estimate.pose_covariance, error))
    low, high = stats.chi2.ppf([1e-3, 1.0 - 1e-3], 6 * runs)
    assert 0.6 * low < sum(squares) < high


def test_steps_do_not_change_their_memory():
    grasp, sensors = three_finger_grasp(), SensorModel(encoder_noise=1e-3, camera=CameraModel())
    estimator, rng = GraspEstimator(grasp, sensors), np.random.default_rng(0)
    memory = estimator.initial_memory(Measurement(0.0, grasp.q))
    for k in range(1, 80):
        pose = PoseMeasurement((k - 40) * PERIOD, grasp.p_HO, grasp.R_HO) if k % 33 == 0 else None
        measurement = Measurement(k * PERIOD, grasp.q + 1e-3 * rng.normal(size=16), object=pose)
        first, after = estimator.step(memory, measurement)
        second, _ = estimator.step(memory, measurement)
        assert first.to_dict() == second.to_dict()
        memory = after


def test_desired_motion_in_the_contact_frame_gives_the_desired_fused_motion():
    """T_desired D⁻¹ D = T_desired, with the twist and acceleration of a rigid body."""
    grasp, rng = three_finger_grasp(), np.random.default_rng(1)
    estimates, _ = estimate_samples(
        GraspEstimator(grasp), rolling_samples(grasp, lambda t: BodyMotion(grasp.p_HO, grasp.R_HO), 2e-3, PERIOD)
    )
    offset_R = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()
    offset_p = np.array([1e-3, 2e-3, -3e-3])
    offset = PoseOffset(offset_p, offset_R)
    estimate = replace(estimates[-1], offset=offset, smooth_offset=offset)
    twist, acceleration = rng.normal(size=6), rng.normal(size=6)
    desired = BodyMotion([0.1, 0.2, 0.3], Rotation.from_rotvec([1.0, 0.5, -0.7]).as_matrix(), twist, acceleration)
    contact = estimate.to_contact_frame(desired)
    np.testing.assert_allclose(contact.p_HO + contact.R_HO @ offset_p, desired.p_HO, atol=1e-15)
    np.testing.assert_allclose(contact.R_HO @ offset_R, desired.R_HO, atol=1e-15)
    lever, omega, alpha = contact.R_HO @ offset_p, twist[3:], acceleration[3:]
    np.testing.assert_allclose(contact.twist[:3] + np.cross(omega, lever), twist[:3], atol=1e-14)
    swept = np.cross(alpha, lever) + np.cross(omega, np.cross(omega, lever))
    np.testing.assert_allclose(contact.acceleration[:3] + swept, acceleration[:3], atol=1e-14)
    there = replace(estimate, object=contact).fused_pose
    np.testing.assert_allclose(there.p_HO, desired.p_HO, atol=1e-15)
    np.testing.assert_allclose(there.twist, twist, atol=1e-14)


def test_slipping_and_lifted_fingers_raise_the_uncertainty_of_the_fused_pose():
    grasp = named_grasp("four_finger sphere")
    still = rolling_samples(grasp, lambda t: BodyMotion(grasp.p_HO, grasp.R_HO), 0.05, PERIOD)
    estimator, three = GraspEstimator(grasp), [True, True, True, False]
    plain, slip, lift = (
        estimate_samples(estimator, still, **options)[0][-1]
        for options in ({}, {"slipping": [True, False, False, False]}, {"touching": three})
    )
    assert np.trace(slip.fused_covariance[:3, :3]) > 2.0 * np.trace(plain.fused_covariance[:3, :3])
    assert np.trace(lift.fused_covariance[:3, :3]) > 2.0 * np.trace(plain.fused_covariance[:3, :3])
    np.testing.assert_allclose(slip.object.p_HO, grasp.p_HO, atol=1e-9)


@pytest.mark.parametrize(("name", "value"), [("slipping", [True, False]), ("touching", [1, 1, 1])])
def test_flags_of_contacts_are_checked(name, value):
    grasp = three_finger_grasp()
    estimator = GraspEstimator(grasp)
    memory = estimator.initial_memory(Measurement(0.0, grasp.q))
    with pytest.raises(InvalidInput) as error:
        estimator.step(memory, Measurement(0.0, grasp.q), **{name: value})
    assert error.value.field == name


def test_measurements_of_another_hand_are_an_error():
    grasp = three_finger_grasp()
    estimator = GraspEstimator(grasp)
    with pytest.raises(InvalidInput, match="16 numbers"):
        estimator.initial_memory(Measurement(0.0, [0.0, 0.0]))
    memory = estimator.initial_memory(Measurement(0.0, grasp.q))
    with pytest.raises(InvalidInput, match=r"measurement\.q"):
        estimator.step(memory, Measurement(1.0, [0.0, 0.0]))


def test_camera_poses_from_before_the_start_are_ignored():
    grasp = three_finger_grasp()
    estimator = GraspEstimator(grasp)
    memory = estimator.initial_memory(Measurement(1.0, grasp.q))
    old = PoseMeasurement(0.5, grasp.p_HO + 1.0, grasp.R_HO)
    estimate, _ = estimator.step(memory, Measurement(1.0, grasp.q, object=old))
    assert estimate.camera_accepted is False
    np.testing.assert_allclose(estimate.fused_pose.p_HO, grasp.p_HO, atol=1e-9)


def test_an_object_that_slid_is_found_by_the_camera_and_tracked_on():
    """After agreeing camera poses, contacts and history start anew at the new pose; the controlled pose has no step."""
    grasp = three_finger_grasp()
    camera = CameraModel(100.0, 0.02, 2e-4, 2e-3)
    estimator = GraspEstimator(grasp, SensorModel(camera=camera))
    slid, turned = grasp.p_HO + np.array([0.0, 0.006, 0.0]), Rotation.from_rotvec([0.0, 0.3, 0.0]).as_matrix() @ grasp.R_HO
    memory, rng = estimator.initial_memory(Measurement(0.0, grasp.q)), np.random.default_rng(3)
    desired, controlled = BodyMotion(grasp.p_HO, grasp.R_HO), []
    for k in range(1, 400):
        t_image = k * PERIOD - camera.latency
        p, R = (grasp.p_HO, grasp.R_HO) if t_image < 0.1 else (slid, turned)
        noise = Rotation.from_rotvec(2e-3 * rng.normal(size=3)).as_matrix()
        image = PoseMeasurement(t_image, p + 2e-4 * rng.normal(size=3), noise @ R) if k % 10 == 0 else None
        estimate, memory = estimator.step(memory, Measurement(k * PERIOD, grasp.q, object=image))
        frame = estimate.to_contact_frame(desired)
        controlled.append(estimate.object.p_HO - frame.p_HO)  # the error that the controller sees
    assert np.linalg.norm(estimate.fused_pose.p_HO - slid) < 3e-4
    assert Rotation.from_matrix(estimate.fused_pose.R_HO @ turned.T).magnitude() < 3e-3
    assert np.linalg.norm(estimate.object.p_HO - slid) < 1e-3  # the contacts are located at the new pose
    assert np.linalg.norm(np.diff(controlled, axis=0), axis=1).max() < 2e-4


@pytest.mark.parametrize("name", ["allegro_right sphere", "four_finger superquadric"])
def test_the_first_samples_improve_the_start(name):
    """The pose of an object at rest is off by the noise of the start, which falls to 0.4 of that of one sample."""
    grasp, sensors, errors, first = named_grasp(name), SensorModel(encoder_noise=1e-3), [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        estimator = GraspEstimator(grasp, sensors, PERIOD)
        measurements = [Measurement(k * PERIOD, grasp.q + 1e-3 * rng.normal(size=grasp.hand.n)) for k in range(33)]
        memory = estimator.initial_memory(measurements[0])
        kept = memory._replace(reference=memory.reference._replace(start=None))  # without improvement
        for measurement in measurements:
            _, memory = estimator.step(memory, measurement)
            _, kept = estimator.step(kept, measurement)
        at_rest = replace(memory.joints, x=np.vstack([grasp.q, np.zeros((2, grasp.hand.n))]))
        for each, found in ((memory, errors), (kept, first)):
            exact = Measurement(each.joints.t + 1e-9, grasp.q)
            estimate, _ = estimator.step(each._replace(joints=at_rest), exact)
            found.append(np.linalg.norm(estimate.object.p_HO - grasp.p_HO))
    assert rms(errors) < 0.6 * rms(first)
