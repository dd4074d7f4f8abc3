"""Estimates are finite after any sequence of measurements: jumps, gaps, lost contacts, and poses far away."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.control_grasps import named_grasp

from graspforce.contact.motion import BodyMotion
from graspforce.core.errors import InvalidInput
from graspforce.estimation import CameraModel, GraspEstimator, Measurement, PoseMeasurement, SensorModel
from graspforce.estimation.estimate import GraspEstimate
from graspforce.estimation.grasp_monitor import AppliedCommand, GraspMonitor, GraspMonitorEstimate
from graspforce.estimation.measurement import LARGEST
from graspforce.geometry.rotations import rotation_exp

PERIOD, GRAVITY = 1e-3, (0.0, 0.0, -9.81)  # s, m/s²
GRASPS = ("allegro_right sphere", "four_finger box", "four_finger superquadric")
SENSORS = (
    SensorModel(),
    SensorModel(encoder_noise=1e-3, torque_noise=1e-3, tip_force_noise=0.02, camera=CameraModel(latency=0.0), latency=2e-3),
)
SCALES = (0.0, 1e-3, 0.1, 10.0, 1e3, LARGEST)

events = st.lists(
    st.tuples(
        st.sampled_from([0.0, PERIOD, PERIOD, PERIOD, 3e-3, 0.2, 1e4, LARGEST]),  # s since the last measurement
        st.sampled_from(SCALES),  # size of the noise of the joint positions, rad
        st.sampled_from(SCALES),  # of torques and forces, N·m and N
        st.sampled_from([None, *SCALES]),  # of the measured position of the object, m; None without a measured pose
        st.booleans(),  # whether the pose has a covariance of zero
        st.sampled_from(["touching", "slipping", "one apart", "all apart"]),
    ),
    min_size=1,
    max_size=12,
)


def arrays_of(value: object, path: str = "") -> list[tuple[str, np.ndarray]]:
    """Return all numbers of an estimate, with their paths."""
    if isinstance(value, float | np.ndarray):
        return [(path, np.asarray(value))]
    if dataclasses.is_dataclass(value):
        names = [each.name for each in dataclasses.fields(value) if not each.name.startswith("_")]
        return [pair for name in names for pair in arrays_of(getattr(value, name), f"{path}.{name}")]
    if isinstance(value, tuple):
        return [pair for i, each in enumerate(value) for pair in arrays_of(each, f"{path}[{i}]")]
    return []


def assert_finite(estimate: GraspEstimate, found: GraspMonitorEstimate) -> None:
    """Assert that all numbers are finite, except for upper bounds and covariances of what no measurement has shown."""
    names = ("joint_covariance", "pose_covariance", "slip_covariance", "twist_covariance", "fused_covariance")
    covariances = [(name, getattr(estimate, name)) for name in names]
    for name, values in [*arrays_of(estimate, "estimate"), *arrays_of(found, "monitor"), *covariances]:
        may_be_infinite = name in ("monitor.friction.upper", "monitor.payload.external_covariance")
        assert not np.isnan(values).any() if may_be_infinite else np.isfinite(values).all(), name


def within_limits(values: np.ndarray) -> np.ndarray:
    """Return numbers that a measurement may have."""
    return np.clip(values, -0.9 * LARGEST, 0.9 * LARGEST)


@pytest.mark.parametrize("grasp_name", GRASPS)
@given(events, st.sampled_from(SENSORS), st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_estimates_are_finite_after_any_measurements(grasp_name, sequence, sensors, seed):
    grasp, rng = named_grasp(grasp_name), np.random.default_rng(seed)
    n, count, start = grasp.hand.n, len(grasp.contacts), BodyMotion(grasp.p_HO, grasp.R_HO)
    estimator, monitor = GraspEstimator(grasp, sensors, PERIOD), GraspMonitor(grasp, sensors, PERIOD, GRAVITY)
    memory, past, t = estimator.initial_memory(Measurement(0.0, grasp.q)), monitor.initial_memory(), 0.0
    for elapsed, joints, force, place, is_exact, contact in [event for event in sequence for _ in range(3)]:
        t, pose = t + elapsed, None
        if place is not None:
            p, R = within_limits(grasp.p_HO + place * rng.normal(size=3)), rotation_exp(rng.normal(size=3))
            pose = PoseMeasurement(t, p, R, np.zeros((6, 6)) if is_exact else None)
        q = within_limits(grasp.q + joints * rng.normal(size=n))
        tau, tips = (within_limits(force * rng.normal(size=shape)) for shape in (n, (count, 6)))
        measurement = Measurement(t, q, tau=tau, tip_wrench=tips if sensors.tip_force_noise else None, object=pose)
        slipping, apart = np.full(count, contact == "slipping"), np.full(count, contact == "all apart")
        apart[0] |= contact == "one apart"
        estimate, memory = estimator.step(memory, measurement, joints * rng.normal(size=n), slipping=slipping, touching=~apart)
        found, past = monitor.step(past, measurement, estimate, memory, AppliedCommand(tau, np.zeros(n), start))
        assert_finite(estimate, found)


@pytest.mark.parametrize("name", ["q", "v", "tau", "current"])
def test_impossible_numbers_are_an_error(name):
    numbers = {"q": [0.0, 0.0], name: [0.0, 1.1 * LARGEST]}
    with pytest.raises(InvalidInput, match=name):
        Measurement(0.0, **numbers)
