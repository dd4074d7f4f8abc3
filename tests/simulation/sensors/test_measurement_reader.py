"""Measurements of a plant: noise, resolution, camera times and outages, fingertip forces."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.simulated_runs import contact_wrench, holding_torques

from graspforce.contact.motion import BodyMotion
from graspforce.control.state import GraspState
from graspforce.estimation import CameraModel, SensorModel
from graspforce.simulation import Plant, build_scene
from graspforce.simulation.sensors.measurement_reader import MeasurementReader
from graspforce.simulation.worlds.world import World

DT = 1e-3


class MovingPlant:
    """A plant whose object moves on a given path; time advances when it is told."""

    dt = DT

    def __init__(self, grasp):
        self.grasp, self.t = grasp, 0.0
        self._contacts = Plant(build_scene(grasp, gravity_H=PALM_UP)).true_contacts()

    def pose(self, t: float) -> BodyMotion:
        turn = Rotation.from_rotvec([0.2 * t, 0.0, 0.1]).as_matrix()
        return BodyMotion(self.grasp.p_HO + t * np.array([0.02, 0.0, 0.01]), turn)

    def state(self) -> GraspState:
        return GraspState(self.grasp.q, np.full(self.grasp.hand.n, 0.3), self.pose(self.t))

    def true_contacts(self):
        return self._contacts


@pytest.fixture(scope="module")
def grasp():
    return three_finger_grasp()


def run(grasp, world, steps):
    """Measurements of steps at 1 kHz, and the reader."""
    plant = MovingPlant(grasp)
    reader, measurements = MeasurementReader(world, grasp), []
    for k in range(steps):
        plant.t = k * DT
        reader.observe(plant)
        measurements.append(reader.read(plant))
    return measurements, reader


def test_perfect_sensors_measure_the_joint_positions_and_nothing_else(grasp):
    (measurement,), _ = run(grasp, World.nominal(), 1)
    np.testing.assert_array_equal(measurement.q, grasp.q)
    others = (measurement.v, measurement.tau, measurement.current, measurement.tip_wrench, measurement.contact_points)
    assert [*others, measurement.object] == [None] * 6


def test_encoders_have_the_stated_noise_and_a_constant_offset(grasp):
    world = World(sensors=SensorModel(encoder_noise=1e-3), encoder_offset=5e-3, seed=3)
    measurements, _ = run(grasp, world, 2000)
    errors = np.array([measurement.q for measurement in measurements]) - grasp.q
    offset = errors.mean(axis=0)
    assert np.abs(offset).max() < 5e-3 + 4 * 1e-3 / np.sqrt(2000)
    assert np.ptp(offset) > 2e-3  # uniform within ±5 mrad
    noise = errors - offset
    assert noise.std() == pytest.approx(1e-3, rel=4 / np.sqrt(2 * noise.size))  # four standard errors
    correlation = np.mean(noise[1:] * noise[:-1]) / np.mean(noise**2)
    assert abs(correlation) < 4 / np.sqrt(noise.size)  # independent from step to step


def test_encoders_are_quantised(grasp):
    (measurement,), _ = run(grasp, World(sensors=SensorModel(encoder_resolution=2e-3)), 1)
    np.testing.assert_allclose(measurement.q, 2e-3 * np.round(grasp.q / 2e-3), atol=1e-15)


def test_camera_poses_are_those_of_their_image_and_arrive_late(grasp):
    """30 Hz and 50 ms: poses are exact at the time of the image, and at the first period after 50 ms they arrive."""
    camera = CameraModel(rate=30.0, latency=0.05, position_noise=1e-12, angle_noise=1e-12)
    measurements, reader = run(grasp, World(sensors=SensorModel(camera=camera)), 1000)
    arrived = [(measurement.t, measurement.object) for measurement in measurements if measurement.object is not None]
    assert len(arrived) == len(reader.poses) == 29  # images at 0, 1/30, … of which those until 0.949 s arrived
    path = MovingPlant(grasp)
    for i, (t, pose) in enumerate(arrived):
        assert i / 30.0 - 1e-9 <= pose.t < i / 30.0 + DT
        assert 0.05 - 1e-9 <= t - pose.t < 0.05 + DT
        np.testing.assert_allclose(pose.p_HO, path.pose(pose.t).p_HO, atol=1e-10)
        np.testing.assert_allclose(pose.R_HO, path.pose(pose.t).R_HO, atol=1e-10)


def test_camera_errors_have_the_reported_covariance(grasp):
    """The mean of the normalised squared error of n poses with 6 components is 6 ± 4 √(12/n)."""
    camera = CameraModel(rate=1000.0, latency=0.0, position_noise=1e-3, angle_noise=0.02)
    measurements, _ = run(grasp, World(sensors=SensorModel(camera=camera)), 1000)
    path, squares = MovingPlant(grasp), []
    for measurement in measurements:
        truth, pose = path.pose(measurement.t), measurement.object
        turned = (Rotation.from_matrix(pose.R_HO) * Rotation.from_matrix(truth.R_HO).inv()).as_rotvec()
        error = np.append(pose.p_HO - truth.p_HO, turned)
        squares.append(error @ np.linalg.solve(pose.covariance, error))
    assert np.mean(squares) == pytest.approx(6.0, abs=4 * np.sqrt(12 / 1000))


def test_camera_bias_is_constant_and_has_the_stated_size(grasp):
    camera = CameraModel(rate=100.0, latency=0.0, position_noise=1e-12, angle_noise=1e-12, position_bias=3e-3, angle_bias=0.02)
    measurements, _ = run(grasp, World(sensors=SensorModel(camera=camera), seed=5), 100)
    path, errors = MovingPlant(grasp), []
    for measurement in measurements:
        if measurement.object is not None:
            truth, pose = path.pose(measurement.t), measurement.object
            turned = (Rotation.from_matrix(pose.R_HO) * Rotation.from_matrix(truth.R_HO).inv()).as_rotvec()
            errors.append(np.append(pose.p_HO - truth.p_HO, turned))
    np.testing.assert_allclose(np.ptp(errors, axis=0), 0.0, atol=1e-9)
    assert np.linalg.norm(errors[0][:3]) == pytest.approx(3e-3)
    assert np.linalg.norm(errors[0][3:]) == pytest.approx(0.02)


def test_no_image_is_taken_in_an_outage_and_outliers_have_their_share(grasp):
    camera = CameraModel(rate=500.0, latency=0.01, position_noise=1e-4, angle_noise=1e-3)
    world = World(sensors=SensorModel(camera=camera), camera_outages=((0.5, 1.0),), camera_outliers=0.1)
    _, reader = run(grasp, world, 4000)
    times = np.array([t for t, _, _ in reader.poses])
    assert not np.any((times >= 0.5) & (times < 1.5))
    assert len(times) == pytest.approx(3.0 * 500.0 - 5, abs=1)
    path = MovingPlant(grasp)
    wrong = [np.linalg.norm(pose.p_HO - path.pose(t).p_HO) > 2e-3 for t, _, pose in reader.poses]
    assert np.mean(wrong) == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / len(wrong)))


def test_noise_of_a_sensor_does_not_depend_on_other_sensors(grasp):
    few, _ = run(grasp, World(sensors=SensorModel(encoder_noise=1e-3)), 3)
    sensors = SensorModel(
        encoder_noise=1e-3, has_velocity=True, velocity_noise=0.1, torque_noise=0.01, tip_force_noise=0.1,
        camera=CameraModel(1000.0),
    )  # fmt: skip
    many, _ = run(grasp, World(sensors=sensors, contact_point_noise=1e-3), 3)
    for first, second in zip(few, many, strict=True):
        np.testing.assert_array_equal(first.q, second.q)


def test_fingertip_forces_and_contact_points_are_those_of_the_plant_in_the_base_frame():
    """Forces and moments about the contact points add up to the wrench of the contacts about O."""
    grasp = three_finger_grasp(model="soft")
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP))
    torques = holding_torques(plant)
    for _ in range(10):
        plant.step(torques())
    sensors = SensorModel(has_velocity=True, torque_noise=0.0, tip_force_noise=0.0)
    measured = MeasurementReader(World(sensors=sensors, contact_point_noise=0.0), grasp).read(plant)
    state = plant.state()
    R_HO, p_HO = state.object.R_HO, state.object.p_HO
    force = measured.tip_wrench[:, :3].sum(axis=0)
    moments = measured.tip_wrench[:, 3:] + np.cross(measured.contact_points - p_HO, measured.tip_wrench[:, :3])
    np.testing.assert_allclose(R_HO.T @ force, contact_wrench(plant)[:3], atol=1e-12)
    np.testing.assert_allclose(R_HO.T @ moments.sum(axis=0), contact_wrench(plant)[3:], atol=1e-12)
    np.testing.assert_array_equal(measured.tau, plant.true_contacts().tau)
    np.testing.assert_array_equal(measured.v, state.v)
