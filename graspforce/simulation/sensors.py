"""Sensors: what a controller gets to see of the true state, late, in steps, and with noise. Seeded, so that a run repeats."""

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


@dataclass(frozen=True, slots=True)
class SensorChannel:
    """One kind of measurement; perfect by default.

    Args:
        noise: standard deviation of each component, independent from step to step.
        resolution: what is read are check_integer multiples of this; zero for none.
    """

    noise: float = 0.0
    resolution: float = 0.0

    def __post_init__(self) -> None:
        for each in fields(self):
            object.__setattr__(self, each.name, arrays.check_number(getattr(self, each.name), each.name, minimum=0.0))

    def read(self, true: Array, rng: np.random.Generator) -> Array:
        """What the sensor says of a true value."""
        value = true + self.noise * rng.standard_normal(true.shape) if self.noise > 0.0 else true
        return np.asarray(self.resolution * np.round(value / self.resolution)) if self.resolution > 0.0 else value


@dataclass(frozen=True, slots=True)
class Sensors:
    """How well the state is measured; perfectly by default.

    Args:
        q, v: the joints, rad and rad/s.
        position, rotation: the object's pose, m and rad (noise turns it about H's axes; the resolution is the rotation
            vector's).
        velocity, spin: the object's twist, m/s and rad/s.
        delay: how old a reading is, s, rounded to check_integer steps. Before it has run, the first state is read.
        seed: of the noise.
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
        object.__setattr__(self, "delay", arrays.check_number(self.delay, "delay", minimum=0.0))
        object.__setattr__(self, "seed", check_integer(self.seed, "seed", minimum=0, maximum=2**32 - 1))


class SensorReader:
    """Sensors at work: one reading a step.

    Args:
        sensors: how well they measure.
        dt: the time between two readings, s.
    """

    def __init__(self, sensors: Sensors, dt: float) -> None:
        self._sensors = sensors
        self._rng = np.random.default_rng(sensors.seed)
        self._past: deque[GraspState] = deque(maxlen=1 + round(sensors.delay / dt))

    def read(self, state: GraspState) -> GraspState:
        """What is measured while the true state is this one."""
        self._past.append(state)
        true, sensors, rng = self._past[0], self._sensors, self._rng
        R_HO = true.object.R_HO
        if sensors.rotation.noise > 0.0 or sensors.rotation.resolution > 0.0:
            turned = Rotation.from_rotvec(sensors.rotation.noise * rng.standard_normal(3)) * Rotation.from_matrix(R_HO)
            resolution = SensorChannel(0.0, sensors.rotation.resolution)
            R_HO = Rotation.from_rotvec(resolution.read(turned.as_rotvec(), rng)).as_matrix()
        velocity = sensors.velocity.read(true.object.twist[:3], rng)
        angular_velocity = sensors.angular_velocity.read(true.object.twist[3:], rng)
        position = sensors.position.read(true.object.p_HO, rng)
        measured = BodyMotion(position, R_HO, np.concatenate([velocity, angular_velocity]))
        return GraspState(sensors.q.read(true.q, rng), sensors.v.read(true.v, rng), measured)
