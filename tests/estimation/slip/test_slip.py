"""The slip detector: its statistics have the distribution that they should, and slip is found in the engine."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.rolling_motion import rolling_samples, smooth_motion

from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.core.errors import InvalidInput
from graspforce.estimation import CameraModel, GraspEstimator, Measurement, PoseMeasurement, SensorModel
from graspforce.estimation.contact_forces import ContactForceEstimator, ForceMemory
from graspforce.estimation.slip.detector import SlipDetector, SlipInputs, pose_error
from graspforce.estimation.slip.slip_settings import SlipSettings
from graspforce.estimation.slip.slip_statistics import WindowGains, WindowMeans, make_slip_test
from graspforce.geometry.rotations import rotation_exp

PERIOD = 1e-3  # s
TIMES = np.array([0.004, 0.02, 0.2])  # s: two windows and the baseline
SENSORS = SensorModel(encoder_noise=1e-3, tip_force_noise=0.02, camera=CameraModel(1000.0, 0.0, 5e-4, 0.01))


def contacts_of(grasp):
    return GraspEstimator(grasp).initial_memory(Measurement(0.0, grasp.q)).pose


def rows_of(grasp):
    """Return A (9, n) and B (9, 6) without the spins."""
    contacts = contacts_of(grasp)
    return contacts.A.reshape(3, 4, -1)[:, :3].reshape(9, -1), contacts.B.reshape(3, 4, 6)[:, :3].reshape(9, 6)


def padded(y):
    """Return residuals (…, 9) with the fourth rows that are not tested, (…, 12)."""
    return np.concatenate([y.reshape(-1, 3, 3), np.full((y.size // 9, 3, 1), 7.0)], axis=2).reshape(*y.shape[:-1], 12)


def test_variances_of_means_are_those_of_their_weights():
    gains, units = WindowGains.for_step(TIMES, PERIOD), np.eye(2000)
    means = WindowMeans.start(units[0], 3)
    for count, unit in enumerate(units[1:], 2):
        means = means.updated(unit, gains)  # the values are now the weights of all residuals
        if count in (5, 50, 150, 500, 1900):
            assert np.allclose(means.values.sum(axis=1), 1.0, atol=1e-12)
            assert np.allclose(means.variance, np.square(means.values).sum(axis=1), rtol=1e-5)


def test_restarted_means_have_the_variance_of_their_window():
    gains, units = WindowGains.for_step(TIMES, PERIOD), np.eye(600)
    means = WindowMeans.start(units[0], 3)
    for unit in units[1:300]:
        means = means.updated(unit, gains)
    means = means.restarted(1)
    assert np.array_equal(means.values, np.tile(means.values[1], (3, 1)))
    assert np.allclose(means.variance, np.square(means.values).sum(axis=1), rtol=1e-5)


def slip_test(grasp, variance, *, has_pose):
    A, B = rows_of(grasp)
    noise = 1e-6 * A @ A.T
    if has_pose:
        noise = noise + B @ np.diag([5e-4**2] * 3 + [0.01**2] * 3) @ B.T
    bias = 1e-10 * np.eye(9)
    return make_slip_test(noise, bias, variance, B, model_error=np.zeros(9), has_pose=has_pose), noise, bias, B


@pytest.mark.parametrize("has_pose", [False, True])
def test_statistics_without_slip_are_chi_squared(has_pose):
    grasp, rng = three_finger_grasp(), np.random.default_rng(1)
    variance = np.array([0.1, 0.02, 0.002])
    test, noise, bias, B = slip_test(grasp, variance, has_pose=has_pose)
    factors = variance[:2] + variance[2]
    roots = [np.linalg.cholesky(c * noise + bias) for c in factors]
    values, draws = [], 4000
    for _ in range(draws):
        means = np.array([root @ rng.normal(size=9) for root in roots] + [np.zeros(9)])
        if not has_pose:
            means += B @ rng.normal(0.0, 0.01, 6)  # any motion of the object
        values.append(test.statistics(WindowMeans(padded(means), variance, 1000)))
    values = np.array(values)
    # slips that no measurement shows have smaller statistics, because of the prior of 10 mm
    assert (values.mean(axis=0) < 2.0 * (1.0 + 4.0 / np.sqrt(draws))).all()
    for x in (4.0, 9.0):
        expected = np.exp(-x / 2.0)
        assert ((values > x).mean(axis=0) < expected + 4.0 * np.sqrt(expected / draws)).all()
    if has_pose:
        assert np.allclose(values.mean(axis=0), 2.0, rtol=0.1)
        assert np.allclose(np.median(values, axis=0), chi2.median(2), rtol=0.15)


@pytest.mark.parametrize("has_pose", [False, True])
def test_joint_statistics_without_slip_are_chi_squared(has_pose):
    grasp, rng = three_finger_grasp(), np.random.default_rng(2)
    variance, draws = np.array([0.1, 0.02, 0.002]), 4000
    test, noise, bias, B = slip_test(grasp, variance, has_pose=has_pose)
    roots = [np.linalg.cholesky(c * noise + bias) for c in variance[:2] + variance[2]]
    values = []
    for _ in range(draws):
        means = np.array([root @ rng.normal(size=9) for root in roots] + [np.zeros(9)])
        if not has_pose:
            means += B @ rng.normal(0.0, 0.01, 6)  # any motion of the object
        values.append(test.joint_statistics(WindowMeans(padded(means), variance, 1000)))
    values = np.array(values)
    freedom = 6 if has_pose else 3  # without the pose, six motions of the object take away from nine residuals
    for x in (12.0, 20.0):
        expected = chi2.sf(x, freedom)
        assert ((values > x).mean(axis=0) < expected + 4.0 * np.sqrt(expected / draws)).all()
    if has_pose:
        assert np.allclose(values.mean(axis=0), 6.0, rtol=0.1)


def test_slip_of_all_fingers_is_less_likely_noise_in_the_joint_statistic():
    grasp, variance = three_finger_grasp(), np.array([0.01, 0.002, 0.001])
    test, _, _, B = slip_test(grasp, variance, has_pose=True)
    y = (B @ [1.5e-4, 0.0, 0.0, 0.0, 0.0, 0.0]).reshape(3, 3)  # m: the object moves by 0.15 mm, and the fingers do not follow
    y[:, 2] = 0.0
    means = WindowMeans(padded(np.array([y.ravel(), y.ravel(), np.zeros(9)])), variance, 1000)
    alone, joint = test.statistics(means).max(), test.joint_statistics(means).max()
    assert chi2.logsf(joint, 6) < chi2.logsf(alone, 2) - 3.0


def test_slip_of_one_finger_is_evident_and_a_jump_of_the_pose_is_not():
    grasp, variance = three_finger_grasp(), np.array([0.01, 0.002, 0.001])
    test, _, _, B = slip_test(grasp, variance, has_pose=True)
    jump = B @ [0.01, -0.02, 0.01, 0.3, 0.2, -0.3]
    slip = np.zeros(9)
    slip[3:5] = 5e-3  # m
    evidence = []
    for y in (slip, slip + jump, jump):
        means = WindowMeans(padded(np.array([y, y, np.zeros(9)])), variance, 1000)
        found = test.slipping_fingers(means, 0, 30.0)
        evidence.append(dict(zip(found.fingers, found.evidence, strict=True)))
    assert evidence[0].keys() == {1}
    assert evidence[0][1] > 10.0
    assert np.isclose(evidence[1][1], evidence[0][1], rtol=1e-3)  # any motion of the object is free
    assert evidence[2]
    assert max(evidence[2].values()) < 1e-2


@pytest.mark.parametrize("fingers", [[1], [0, 2]])
def test_slips_are_estimated_and_blamed_on_their_fingers(fingers):
    grasp = three_finger_grasp()
    variance = np.array([0.01, 0.002, 0.001])
    test, _, _, _ = slip_test(grasp, variance, has_pose=True)
    y, slips = np.zeros((3, 3, 3)), np.array([[2e-3, -1e-3], [1e-3, 2e-3], [-2e-3, 1e-3]])[fingers]
    y[:2, fingers, :2] = slips
    means = WindowMeans(padded(y.reshape(3, 9)), variance, 1000)
    found, distances, is_certain, _ = test.slipping_fingers(means, 1, 30.0)
    assert sorted(found) == fingers
    assert is_certain
    assert np.allclose(distances[np.argsort(found)], slips, rtol=0.02)


def test_motions_of_the_object_are_no_slip_without_its_pose():
    grasp, variance = three_finger_grasp(), np.array([0.01, 0.002, 0.001])
    test, _, _, B = slip_test(grasp, variance, has_pose=False)
    y = np.zeros((3, 9))
    y[:2] = B @ [0.01, -0.02, 0.01, 0.3, 0.2, -0.3]
    assert test.statistics(WindowMeans(padded(y), variance, 1000)).max() < 1e-3


def quiet_steps(grasp, sensors, duration, seed, *, has_pose):
    """Run estimator and detector on a hand that rolls without slip, with noise of the sensors; yield the slip estimates."""
    rng = np.random.default_rng(seed)
    estimator, detector = GraspEstimator(grasp, sensors, PERIOD), SlipDetector(3, sensors, PERIOD)
    memory = slip_memory = None
    motion = smooth_motion(grasp, np.array([0.0, -0.005, 0.003]), np.array([0.05, 0.0, 0.0]), 1.0)
    for sample in rolling_samples(grasp, motion, duration, PERIOD):
        q = sample.q + sensors.encoder_noise * rng.normal(size=grasp.hand.n)
        memory = memory or estimator.initial_memory(Measurement(0.0, sample.q), 50)
        estimate, memory = estimator.step(memory, Measurement(sample.t, q))
        error = None
        if has_pose:
            R = rotation_exp(0.01 * rng.normal(size=3)) @ sample.object.R_HO
            measured = PoseMeasurement(sample.t, sample.object.p_HO + 5e-4 * rng.normal(size=3), R)
            error = pose_error(measured, estimate.object.p_HO, estimate.object.R_HO)
        slip_memory = slip_memory or detector.initial_memory(memory.pose)
        slip, slip_memory = detector.step(slip_memory, SlipInputs(sample.t, memory.pose, q - estimate.q, error))
        yield slip


@pytest.mark.parametrize("has_pose", [False, True])
def test_rolling_without_slip_gives_no_alarm_and_small_statistics(has_pose):
    values = []
    for slip in quiet_steps(three_finger_grasp(), SENSORS, 1.0, 3, has_pose=has_pose):
        assert not slip.slipping.any()
        assert not slip.has_alarm
        values.append(slip.statistics)
    values = np.array(values[200:])
    assert values.shape[1] == 3 * 5
    # neighbouring values are correlated: the shortest window of 2 ms has some 100 independent ones, a χ² mean of 2 ± 0.8
    assert values[:, :3].mean() < 2.8
    assert values.max() < 2.0 * np.log(values.size) + 12.0


def test_pose_error_is_the_motion_between_two_poses():
    R, turn = rotation_exp(np.array([0.3, -0.2, 0.1])), np.array([0.01, 0.02, -0.01])
    p, shift = np.array([0.1, 0.0, 0.2]), np.array([1e-3, 2e-3, -1e-3])
    measured = PoseMeasurement(0.0, p + R @ shift, R @ rotation_exp(turn))
    assert np.allclose(pose_error(measured, p, R), np.concatenate([shift, turn]), atol=1e-12)


def simulate_friction_drop(mu, start, duration):
    """Return alarms, limits and true slip of a simulation in which the friction of all contacts falls."""
    simulation = pytest.importorskip("graspforce.simulation")
    grasp, rng = three_finger_grasp(), np.random.default_rng(5)
    drop = simulation.FrictionChange(mu, start)
    plant = simulation.Plant(simulation.build_scene(grasp, gravity_H=PALM_UP), disturbances=(drop,))
    controller = ObjectController(grasp, ControlSettings(gravity_H=PALM_UP))
    estimator = GraspEstimator(grasp, SENSORS, PERIOD)
    forces_of, detector = ContactForceEstimator(grasp, SENSORS, PALM_UP), SlipDetector(3, SENSORS, PERIOD)
    start_pose = BodyMotion(grasp.p_HO, grasp.R_HO)
    first = controller.step(plant.reset(), start_pose)
    controller.reset()
    state, memory, force_memory, slip_memory = plant.reset(first.f), None, ForceMemory(), None
    tau, acceleration, estimates, true_slip = first.tau, None, [], [0.0]
    for k in range(round(duration / PERIOD)):
        t, contacts = k * PERIOD, plant.true_contacts()
        q = state.q + 1e-3 * rng.normal(size=grasp.hand.n)
        tips = np.zeros((3, 6))
        tips[:, :3] = np.einsum("ij,njk,nk->ni", state.object.R_HO, contacts.R_OC, contacts.f[:, :3])
        tips[:, :3] += 0.02 * rng.normal(size=(3, 3))
        R = rotation_exp(0.01 * rng.normal(size=3)) @ state.object.R_HO
        pose = PoseMeasurement(t, state.object.p_HO + 5e-4 * rng.normal(size=3), R)
        memory = memory or estimator.initial_memory(Measurement(0.0, state.q), 50)
        estimate, memory = estimator.step(memory, Measurement(t, q, tip_wrench=tips), acceleration)
        joints = np.array([estimate.q, estimate.v, estimate.disturbance])
        forces, force_memory = forces_of.step(force_memory, memory.pose, joints, tau, acceleration, tips)
        slip_memory = slip_memory or detector.initial_memory(memory.pose)
        error = pose_error(pose, estimate.object.p_HO, estimate.object.R_HO)
        inputs = SlipInputs(t, memory.pose, q - estimate.q, error, forces, grasp.contacts.mu)
        slip, slip_memory = detector.step(slip_memory, inputs)
        estimates.append(slip)
        command = controller.step(state, start_pose)
        true_slip.append(max(true_slip[-1], np.linalg.norm(controller.memory.creep, axis=1).max()))
        tau, acceleration = command.tau, command.joint_acceleration
        state = plant.step(tau)
    return estimates, np.array(true_slip[1:])


def test_slip_after_a_drop_of_friction_is_found():
    estimates, true_slip = simulate_friction_drop(0.1, 0.25, 0.35)
    slipping = np.array([each.slipping.any() for each in estimates])
    begin = int(np.argmax(true_slip > 5e-5))
    half = int(np.argmax(true_slip > 5e-4))
    assert half > begin > 250
    assert not slipping[:begin].any()
    assert slipping[: half + 20].any()  # 20 ms after 0.5 mm
    found = estimates[int(np.argmax(slipping))]
    assert found.has_alarm
    assert found.alarms.any()
    assert 2e-4 < np.linalg.norm(found.distance, axis=1).max() < 5e-3  # m


def test_no_slip_without_a_drop_of_friction():
    estimates, true_slip = simulate_friction_drop(0.69, 0.25, 0.35)
    assert true_slip.max() < 2e-5
    assert not any(each.slipping.any() or each.at_limit.any() for each in estimates)


def test_contacts_at_their_friction_limit_are_reported():
    grasp = three_finger_grasp()
    contacts, detector = contacts_of(grasp), SlipDetector(3, SENSORS, PERIOD)
    estimator = ContactForceEstimator(grasp, SENSORS, PALM_UP)
    joints = np.array([grasp.q, np.zeros(16), np.zeros(16)])
    f = np.array([[0.6, 0.3, 1.0], [0.1, 0.0, 1.0], [0.0, 0.0, 0.0]])  # the first: ‖f_t‖ = 0.67 N
    tau = grasp.hand.gravity_torque(grasp.q, PALM_UP) + rows_of(grasp)[0].T @ f.ravel()
    tips = np.zeros((3, 6))
    tips[:, :3] = np.einsum("ij,njk,nk->ni", contacts.R_HO, contacts.R_OC, f)
    memory, force_memory = detector.initial_memory(contacts), ForceMemory()
    for mu, limits in ((0.7, [True, False, False]), (0.9, [False, False, False])):
        for k in range(20):
            forces, force_memory = estimator.step(force_memory, contacts, joints, tau, None, tips)
            inputs = SlipInputs(k * PERIOD, contacts, np.zeros(16), None, forces, np.full(3, mu))
            slip, memory = detector.step(memory, inputs)
        assert slip.at_limit.tolist() == limits


def test_without_a_pose_the_contacts_alone_are_tested():
    grasp = three_finger_grasp()
    contacts, detector = contacts_of(grasp), SlipDetector(3, SENSORS, PERIOD)
    memory, counts = detector.initial_memory(contacts), []
    for k in range(44):
        error = np.zeros(6) if k < 20 or k == 40 else None
        slip, memory = detector.step(memory, SlipInputs(k * PERIOD, contacts, np.zeros(16), error))
        counts.append(len(slip.statistics))
    assert counts[:20] == [15] * 20
    assert counts[25:41] == [15] * 16  # 5 ms after the last pose
    assert counts[20:24] == [0] * 4
    assert counts[41:] == [0] * 3


def test_thresholds_follow_the_wanted_interval():
    grasp = three_finger_grasp()
    thresholds = []
    for interval in (100.0, 1e4):
        detector = SlipDetector(3, SENSORS, PERIOD, SlipSettings(false_alarm_interval=interval))
        inputs = SlipInputs(0.0, contacts_of(grasp), np.zeros(16))
        slip, _ = detector.step(detector.initial_memory(contacts_of(grasp)), inputs)
        thresholds.append(slip.threshold)
    assert np.isclose(thresholds[1] - thresholds[0], 2.0 * np.log(100.0))


def test_settings_survive_their_record():
    settings = SlipSettings(windows=(0.01, 0.1), hold_time=0.1)
    assert SlipSettings.from_dict(settings.to_dict()) == settings


@pytest.mark.parametrize(
    ("field", "value"), [("windows", [0.1, 0.01]), ("windows", []), ("limit_ratio", 0.5), ("baseline", 0.0), ("hold", 1.0)]
)
def test_settings_reject_bad_values(field, value):
    with pytest.raises(InvalidInput) as caught:
        SlipSettings.from_dict({field: value})
    assert caught.value.field == f"slip.{field}"
