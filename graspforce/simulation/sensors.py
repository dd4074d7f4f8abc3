"""Sensors: what a controller gets to see of the true state, late, in steps, and with noise. Seeded, so that a run repeats."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, fields

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce import arrays
from graspforce.arrays import Array
from graspforce.body import BodyMotion
from graspforce.control.state import GraspState
from graspforce.fields import whole


@dataclass(frozen=True, slots=True)
class Channel:
    """One kind of measurement; perfect by default.

    Args:
        noise: standard deviation of each component, independent from step to step.
        resolution: what is read are whole multiples of this; zero for none.
    """

    noise: float = 0.0
    resolution: float = 0.0

    def __post_init__(self) -> None:
        for each in fields(self):
            object.__setattr__(self, each.name, arrays.number(getattr(self, each.name), each.name, minimum=0.0))

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
        delay: how old a reading is, s, rounded to whole steps. Before it has run, the first state is read.
        seed: of the noise.
    """

    q: Channel = field(default_factory=Channel)
    v: Channel = field(default_factory=Channel)
    position: Channel = field(default_factory=Channel)
    rotation: Channel = field(default_factory=Channel)
    velocity: Channel = field(default_factory=Channel)
    spin: Channel = field(default_factory=Channel)
    delay: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "delay", arrays.number(self.delay, "delay", minimum=0.0))
        object.__setattr__(self, "seed", whole(self.seed, "seed", minimum=0, maximum=2**32 - 1))


class Reader:
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
            resolution = Channel(0.0, sensors.rotation.resolution)
            R_HO = Rotation.from_rotvec(resolution.read(turned.as_rotvec(), rng)).as_matrix()
        velocity = sensors.velocity.read(true.object.twist[:3], rng)
        spin = sensors.spin.read(true.object.twist[3:], rng)
        position = sensors.position.read(true.object.p_HO, rng)
        measured = BodyMotion(position, R_HO, np.concatenate([velocity, spin]))
        return GraspState(sensors.q.read(true.q, rng), sensors.v.read(true.v, rng), measured)
