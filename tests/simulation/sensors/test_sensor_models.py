"""Sensor models: delay, resolution, noise."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspState
from graspforce.simulation.sensors.sensor_models import SensorChannel, SensorReader, Sensors


def states(n: int) -> list[GraspState]:
    rng = np.random.default_rng(8)
    R = Rotation.random(n, random_state=8).as_matrix()
    motions = [BodyMotion(rng.normal(size=3), R[i], rng.normal(size=6)) for i in range(n)]
    return [GraspState(rng.normal(size=4), rng.normal(size=4), motion) for motion in motions]


def test_perfect_sensors_return_the_state_and_delayed_ones_an_earlier_state():
    true = states(6)
    perfect, late = SensorReader(Sensors(), 1e-3), SensorReader(Sensors(delay=2e-3), 1e-3)
    for k, state in enumerate(true):
        np.testing.assert_array_equal(perfect.read(state).object.R_HO, state.object.R_HO)
        was, said = true[max(k - 2, 0)], late.read(state)
        np.testing.assert_array_equal(said.q, was.q)
        np.testing.assert_array_equal(said.object.twist, was.object.twist)


def test_measurements_are_multiples_of_the_resolution():
    sensors = Sensors(*(SensorChannel(0.0, size) for size in (0.1, 0.2, 0.3, 0.05, 0.4, 0.5)))
    for state in states(5):
        said = SensorReader(sensors, 1e-3).read(state)
        read = (said.q, said.v, said.object.p_HO, said.object.twist[:3], said.object.twist[3:])
        truth = (state.q, state.v, state.object.p_HO, state.object.twist[:3], state.object.twist[3:])
        for value, true, size in zip(read, truth, (0.1, 0.2, 0.3, 0.4, 0.5), strict=True):
            np.testing.assert_allclose(value / size, np.round(value / size), atol=1e-9)
            assert np.abs(value - true).max() <= size / 2 + 1e-12
        rotation = Rotation.from_matrix(said.object.R_HO).as_rotvec() / 0.05
        np.testing.assert_allclose(rotation, np.round(rotation), atol=1e-6)


def test_noise_has_the_stated_deviation_in_every_channel():
    """The deviation of 4000 measurements has a standard error of 1.1 %; 5 % are more than four times that."""
    sensors = Sensors(*(SensorChannel(size) for size in (0.01, 0.02, 0.03, 0.04, 0.05, 0.06)), seed=5)
    state, reader = states(1)[0], SensorReader(sensors, 1e-3)
    said = [reader.read(state) for _ in range(4000)]
    true = state.object
    off = {
        0.01: [s.q - state.q for s in said],
        0.02: [s.v - state.v for s in said],
        0.03: [s.object.p_HO - true.p_HO for s in said],
        0.04: Rotation.from_matrix([s.object.R_HO @ true.R_HO.T for s in said]).as_rotvec(),
        0.05: [s.object.twist[:3] - true.twist[:3] for s in said],
        0.06: [s.object.twist[3:] - true.twist[3:] for s in said],
    }
    for size, values in off.items():
        np.testing.assert_allclose(np.std(values, axis=0), size, rtol=0.05)
        np.testing.assert_allclose(np.mean(values, axis=0), 0.0, atol=4.5 * size / np.sqrt(4000))
