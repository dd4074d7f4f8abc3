"""The slip detector in C equals the reference in NumPy to rounding."""

from __future__ import annotations

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.control_grasps import named_grasp
from support.rolling_motion import rolling_samples, smooth_motion
from support.shapes import SURFACES

from graspforce.estimation import CameraModel, GraspEstimator, Measurement, SensorModel
from graspforce.estimation.compiled_contact_forces import CompiledForceEstimator
from graspforce.estimation.contact_forces import ForceMemory
from graspforce.estimation.slip.compiled_detector import CompiledSlipDetector, make_detector
from graspforce.estimation.slip.detector import SlipDetector, SlipInputs
from graspforce.estimation.slip.slip_settings import SlipSettings
from graspforce.geometry import Sphere

pytest.importorskip("graspforce.core._native", reason="the compiled module was not built: no C compiler at installation")

PERIOD = 1e-3  # s
SENSORS = SensorModel(1e-3, 1e-4, torque_noise=1e-3, tip_force_noise=0.02, camera=CameraModel(1000.0, 0.0, 5e-4, 0.01))
ROUNDING = 1e-10  # relative to the largest statistic, and to a slip of 1 mm
FLAGS = ("slipping", "alarms", "evident", "at_limit")


def inputs_of(grasp, rng, times, *, slip_from, pose_every):
    """Yield inputs of a hand in motion whose second fingertip slips by 0.1 mm a period, with unexpected forces meanwhile."""
    estimator, forces_of = GraspEstimator(grasp, SENSORS, PERIOD), CompiledForceEstimator(grasp, SENSORS, PALM_UP)
    motion = smooth_motion(grasp, np.array([0.0, -0.003, 0.002]), np.array([0.05, 0.0, 0.0]), 1.0)
    samples = list(rolling_samples(grasp, motion, len(times) * PERIOD, PERIOD))
    memory, force_memory, n, count = None, ForceMemory(), grasp.hand.n, len(grasp.contacts)
    for k, t in enumerate(times):
        q = samples[k].q + SENSORS.encoder_noise * rng.normal(size=n)
        memory = memory or estimator.initial_memory(Measurement(t, samples[k].q), 50)
        estimate, memory = estimator.step(memory, Measurement(t, q))
        contacts, is_slipping = memory.pose, slip_from <= k < slip_from + 20
        f = np.tile([0.1, 0.2 + 0.5 * is_slipping, 1.0], (count, 1))
        tips = np.zeros((count, 6))
        tips[:, :3] = np.einsum("ij,njk,nk->ni", contacts.R_HO, contacts.R_OC, f) + 0.02 * rng.normal(size=(count, 3))
        A = contacts.A.reshape(count, 4, n)[:, :3].reshape(3 * count, n)
        tau = grasp.hand.gravity_torque(estimate.q, PALM_UP) + A.T @ np.tile([0.1, 0.2, 1.0], count)
        joints = np.array([estimate.q, np.zeros(n), np.zeros(n)])
        forces, force_memory = forces_of.step(force_memory, contacts, joints, tau, None, tips)
        moved = np.zeros(3 * count)
        moved[3] = 1e-4 * max(k - slip_from, 0) if slip_from >= 0 else 0.0  # m
        error = q - estimate.q + np.linalg.pinv(A) @ moved
        pose_error = np.array([5e-4] * 3 + [0.01] * 3) * rng.normal(size=6) if pose_every and k % pose_every == 0 else None
        yield SlipInputs(float(t), contacts, error, pose_error, forces if k % 50 != 7 else None, np.full(count, 0.5))


def compare(grasp, times, settings=None, **scenario):
    """Compare both detectors, and return the number of alarms."""
    count, memories, alarms = len(grasp.contacts), [None, None], 0
    detectors = [kind(count, SENSORS, PERIOD, settings) for kind in (CompiledSlipDetector, SlipDetector)]
    for inputs in inputs_of(grasp, np.random.default_rng(4), times, **scenario):
        results = []
        for i, detector in enumerate(detectors):
            memory = memories[i] or detector.initial_memory(inputs.contacts)
            result, memories[i] = detector.step(memory, inputs)
            results.append(result)
        found, expected = results
        for name in FLAGS:
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
        for name in ("has_alarm", "is_certain", "force_alert", "threshold"):
            assert getattr(found, name) == getattr(expected, name)
        assert found.statistics.shape == expected.statistics.shape
        found_memory, expected_memory = memories
        state = found_memory.state
        np.testing.assert_allclose(state["residual"], expected_memory.residual, rtol=0.0, atol=ROUNDING * 1e-3)
        np.testing.assert_allclose(state["force_statistic"], expected_memory.force_statistic, rtol=1e-9)
        if expected_memory.forces is not None:
            np.testing.assert_allclose(state["level"], expected_memory.force_level, rtol=1e-9)
        scale = max(expected.statistics.max(initial=0.0), 1.0)
        np.testing.assert_allclose(found.statistics, expected.statistics, rtol=0.0, atol=ROUNDING * scale)
        np.testing.assert_allclose(found.distance, expected.distance, rtol=0.0, atol=ROUNDING * 1e-3)
        alarms += found.has_alarm
    return alarms


@pytest.mark.parametrize("pose_every", [0, 1, 4, 30])
@pytest.mark.parametrize("name", ["allegro", "four_finger box"])
def test_statistics_and_alarms_equal_those_of_the_reference(name, pose_every):
    grasp = three_finger_grasp() if name == "allegro" else named_grasp(name)
    times = PERIOD * np.arange(400)
    assert compare(grasp, times, slip_from=300, pose_every=pose_every) > 0


def test_gaps_and_repeated_measurements_equal_those_of_the_reference():
    times = np.cumsum(np.full(200, PERIOD))
    times[50:] += 0.0203
    times[100:] += 1.5  # s: longer than the baseline, which starts anew
    for pose_every in (0, 1):
        compare(three_finger_grasp(), times, slip_from=150, pose_every=pose_every)


def test_other_windows_equal_those_of_the_reference():
    settings = SlipSettings(windows=(0.005, 0.05), baseline=0.3, alert_interval=1.0)
    assert compare(three_finger_grasp(), PERIOD * np.arange(300), settings, slip_from=250, pose_every=1) > 0


def test_surfaces_that_the_c_code_lacks_use_the_reference():
    assert type(make_detector(3, Sphere(0.03), SENSORS, PERIOD)) is CompiledSlipDetector
    assert type(make_detector(3, SURFACES["implicit"], SENSORS, PERIOD)) is SlipDetector
