"""Measurements of a plant in a world: encoders, a camera, fingertip sensors, joint torques and currents, with their errors."""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.core.arrays import Array, freeze
from graspforce.estimation.current_torques import CurrentTorques
from graspforce.estimation.measurement import Measurement, PoseMeasurement
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.plants.plant_interface import PlantInterface
from graspforce.simulation.sensors.sensor_models import SensorChannel
from graspforce.simulation.worlds.world import World, random_direction

_FIRST_STREAM = 100  # of random numbers; the world uses smaller numbers
_ENCODER, _VELOCITY, _TORQUE, _TIP, _POINT, _CAMERA, _OFFSET, _BIAS, _CURRENT = range(_FIRST_STREAM, _FIRST_STREAM + 9)
_OUTLIER_DISTANCE, _OUTLIER_ANGLE = 0.05, 1.0  # m and rad: standard deviations of an outlier's error, for each component
_TIP_SENSOR_ARM = 0.01  # m: noise of a fingertip's moment is this length times the noise of its force
_ROUNDING = 1e-9  # s: sums of time steps


class MeasurementReader:
    """The sensors of a world in a running simulation.

    Call `observe` in every step of the plant, and then `read` in each control period.

    Args:
        world: the sensors and their errors.
        grasp: the grasp of the plant.

    Attributes:
        poses: (image time, arrival time, pose) of every pose of the camera that arrived, s.
    """

    def __init__(self, world: World, grasp: Grasp) -> None:
        self._world, self._sensors = world, world.sensors
        rng = world.rng
        self._rng = {name: rng(name) for name in (_ENCODER, _VELOCITY, _TORQUE, _TIP, _POINT, _CAMERA, _CURRENT)}
        self._encoder = SensorChannel(world.sensors.encoder_noise, world.sensors.encoder_resolution)
        self._velocity, self._torque, self._point = (
            SensorChannel(noise or 0.0)
            for noise in (world.sensors.velocity_noise, world.sensors.torque_noise, world.contact_point_noise)
        )
        self._current = SensorChannel(world.sensors.current_noise or 0.0)
        self._motors = None if world.sensors.current_noise is None else CurrentTorques(grasp.hand)
        self._encoder_offset = world.encoder_offset * rng(_OFFSET).uniform(-1.0, 1.0, grasp.hand.n)  # rad
        self._position_bias, self._rotation_bias = np.zeros(3), Rotation.identity()
        if self._sensors.camera is not None:
            bias = rng(_BIAS)
            self._position_bias = self._sensors.camera.position_bias * random_direction(bias)
            self._rotation_bias = Rotation.from_rotvec(self._sensors.camera.angle_bias * random_direction(bias))
        self._images = 0  # exposures so far, lost images included
        self._in_transit: deque[PoseMeasurement] = deque()
        self.poses: list[tuple[float, float, PoseMeasurement]] = []

    def observe(self, plant: PlantInterface) -> None:
        """Take an image if one is due at the plant's time.

        Args:
            plant: the plant.
        """
        camera = self._sensors.camera
        if camera is None or plant.t + _ROUNDING < self._images / camera.rate:
            return
        self._images = max(self._images + 1, int((plant.t + _ROUNDING) * camera.rate) + 1)
        image = self._take_image(plant)
        is_lost = any(start <= plant.t < start + duration for start, duration in self._world.camera_outages)
        if not is_lost:
            self._in_transit.append(image)

    def read(self, plant: PlantInterface) -> Measurement:
        """Return the measurement of a control period, with the newest pose that arrived since the last one.

        Contacts are those of the plant's last step.

        Args:
            plant: the plant.
        """
        sensors, state, contacts = self._sensors, plant.state(), plant.true_contacts()
        v = tau = current = tip_wrench = contact_points = None
        if sensors.has_velocity:
            v = self._velocity.read(state.v, self._rng[_VELOCITY])
        if sensors.torque_noise is not None:
            tau = self._torque.read(contacts.tau, self._rng[_TORQUE])
        if self._motors is not None:
            current = self._current.read(self._motors.currents(contacts.tau, state.v), self._rng[_CURRENT])
        R_HO, p_HO = state.object.R_HO, state.object.p_HO
        if sensors.tip_force_noise is not None:
            wrench = np.zeros((len(contacts.f), 6))  # N and N·m, in O
            wrench[:, :3] = np.einsum("nij,nj->ni", contacts.R_OC, contacts.f[:, :3])
            wrench[:, 3:] = contacts.R_OC[:, :, 2] * contacts.f[:, 3:]
            in_H = (wrench.reshape(-1, 3) @ R_HO.T).reshape(-1, 6)
            noise = sensors.tip_force_noise * np.repeat([1.0, _TIP_SENSOR_ARM], 3)
            tip_wrench = in_H + noise * self._rng[_TIP].standard_normal(in_H.shape)
        if self._world.contact_point_noise is not None:
            points = p_HO + contacts.p_OC @ R_HO.T
            contact_points = self._point.read(points, self._rng[_POINT])
        q = self._encoder.read(state.q + self._encoder_offset, self._rng[_ENCODER])
        return Measurement(plant.t, q, v, tau, current, tip_wrench, contact_points, self._arrived_pose(plant.t))

    def _take_image(self, plant: PlantInterface) -> PoseMeasurement:
        """Return the pose in an image of the plant's present state."""
        camera, rng, motion = self._sensors.camera, self._rng[_CAMERA], plant.state().object
        assert camera is not None  # observe() checks it
        position_noise, rotation_noise, outlier = rng.standard_normal(3), rng.standard_normal(3), rng.standard_normal(6)
        p = motion.p_HO + self._position_bias + camera.position_noise * position_noise
        error = Rotation.from_rotvec(camera.angle_noise * rotation_noise) * self._rotation_bias
        if rng.uniform() < self._world.camera_outliers:
            p = p + _OUTLIER_DISTANCE * outlier[:3]
            error = Rotation.from_rotvec(_OUTLIER_ANGLE * outlier[3:]) * error
        variance = np.repeat([camera.position_noise**2, camera.angle_noise**2], 3)
        R = (error * Rotation.from_matrix(motion.R_HO)).as_matrix()
        return PoseMeasurement(plant.t, p, R, _diagonal(variance))

    def _arrived_pose(self, t: float) -> PoseMeasurement | None:
        """Return the newest pose that arrived until t, and forget the older ones."""
        camera, newest = self._sensors.camera, None
        while camera is not None and self._in_transit and self._in_transit[0].t + camera.latency <= t + _ROUNDING:
            newest = self._in_transit.popleft()
        if newest is not None:
            self.poses.append((newest.t, t, newest))
        return newest


def _diagonal(values: Array) -> Array:
    """Return a read-only diagonal matrix."""
    return freeze(np.diag(values))
