"""Sensor models: delay, noise and resolution of the measured state. Seeds make runs repeatable."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, fields

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact.motion import BodyMotion
from graspforce.control.state import GraspState
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.fields import check_integer
from graspforce.core.records import set_fields


@dataclass(frozen=True, slots=True)
class SensorChannel:
    """Noise and resolution of one measured quantity; perfect by default.

    Args:
        noise: standard deviation of each component, independent between steps, in the quantity's unit.
        resolution: measured values are integer multiples of it; zero for continuous values.

    Raises:
        InvalidInput: a value is negative.
    """

    noise: float = 0.0
    resolution: float = 0.0

    def __post_init__(self) -> None:
        for each in fields(self):
            set_fields(self, **{each.name: arrays.check_number(getattr(self, each.name), each.name, minimum=0.0)})

    def read(self, true: Array, rng: np.random.Generator) -> Array:
        """Return a measurement.

        Args:
            true: the true value.
            rng: source of the noise.
        """
        value = true + self.noise * rng.standard_normal(true.shape) if self.noise > 0.0 else true
        return np.asarray(self.resolution * np.round(value / self.resolution)) if self.resolution > 0.0 else value


@dataclass(frozen=True, slots=True)
class Sensors:
    """Sensors of the state; perfect by default.

    Args:
        q: joint positions, rad.
        v: joint rates, rad/s.
        position: position of the object, m.
        rotation: orientation of the object, rad. Noise rotates about H's axes; the resolution is that of the rotation vector.
        velocity: velocity of the object, m/s.
        angular_velocity: angular velocity of the object, rad/s.
        delay: age of a measurement, s, rounded to whole steps. Before that time has passed, the first state is measured.
        seed: of the noise.

    Raises:
        InvalidInput: a negative delay, or a seed outside 0 to 2³² − 1.
    """

    q: SensorChannel = field(default_factory=SensorChannel)
    v: SensorChannel = field(default_factory=SensorChannel)
    position: SensorChannel = field(default_factory=SensorChannel)
    rotation: SensorChannel = field(default_factory=SensorChannel)
    velocity: SensorChannel = field(default_factory=SensorChannel)
    angular_velocity: SensorChannel = field(default_factory=SensorChannel)
    delay: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        delay = arrays.check_number(self.delay, "delay", minimum=0.0)
        set_fields(self, delay=delay, seed=check_integer(self.seed, "seed", minimum=0, maximum=2**32 - 1))


class SensorReader:
    """Sensors in a running simulation: one measurement per step.

    Args:
        sensors: the sensor models.
        dt: time between two measurements, s.
    """

    def __init__(self, sensors: Sensors, dt: float) -> None:
        self._sensors = sensors
        self._rng = np.random.default_rng(sensors.seed)
        self._past: deque[GraspState] = deque(maxlen=1 + round(sensors.delay / dt))

    def read(self, state: GraspState) -> GraspState:
        """Return the measurement of a step.

        Args:
            state: the true state of the step.
        """
        self._past.append(state)
        true, sensors, rng = self._past[0], self._sensors, self._rng
        R_HO = true.object.R_HO
        if sensors.rotation.noise > 0.0 or sensors.rotation.resolution > 0.0:
            rotation = Rotation.from_rotvec(sensors.rotation.noise * rng.standard_normal(3)) * Rotation.from_matrix(R_HO)
            resolution = SensorChannel(0.0, sensors.rotation.resolution)
            R_HO = Rotation.from_rotvec(resolution.read(rotation.as_rotvec(), rng)).as_matrix()
        velocity = sensors.velocity.read(true.object.twist[:3], rng)
        angular_velocity = sensors.angular_velocity.read(true.object.twist[3:], rng)
        position = sensors.position.read(true.object.p_HO, rng)
        measured = BodyMotion(position, R_HO, np.concatenate([velocity, angular_velocity]))
        return GraspState(sensors.q.read(true.q, rng), sensors.v.read(true.v, rng), measured)
