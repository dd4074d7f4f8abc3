"""What happens to the plant: pushes, loads, grease, a finger pulled away, a dead motor. Frozen records with their times."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import mujoco
import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.geometry.vectors import cross
from graspforce.simulation.plant import Plant


@dataclass(frozen=True, eq=False, slots=True)
class Push:
    """A force on the object for a while.

    Args:
        force: (3,) in H, N.
        start, duration: s.
        point: (3,) where it acts, in O, m; O's origin by default.
    """

    force: Array
    start: float
    duration: float
    point: Array = field(default_factory=lambda: freeze(np.zeros(3)))

    def __post_init__(self) -> None:
        object.__setattr__(self, "force", arrays.check_array(self.force, "force", (3,)))
        object.__setattr__(self, "point", arrays.check_array(self.point, "point", (3,)))
        _check_times(self)

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """Add the force to what acts on the object in the step that begins at t; torques pass."""
        if self.start <= t < self.start + self.duration:
            arm = plant.object_motion().R_HO @ (
                self.point - plant.model.body_ipos[plant.scene.object_body]
            )  # m, from the mass centre
            plant.pull(plant.scene.object_body, self.force, cross(arm.tolist(), self.force.tolist()))
        return tau


@dataclass(frozen=True, slots=True)
class MassChange:
    """The object's mass and inertia times a factor, from an instant on: something drops into it, or is taken out.

    A mass that is wrong from the beginning is ``body`` of `build_scene`.

    Args:
        factor: > 0.
        start: s.
    """

    factor: float
    start: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "factor", arrays.check_number(self.factor, "factor", above=0.0))
        object.__setattr__(self, "start", arrays.check_number(self.start, "start", minimum=0.0))

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """Change the plant's model in the first step from ``start`` on; torques pass."""
        if self.start <= t < self.start + plant.dt:
            plant.model.body_mass[plant.scene.object_body] *= self.factor
            plant.model.body_inertia[plant.scene.object_body] *= self.factor
            mujoco.mj_setConst(plant.model, mujoco.MjData(plant.model))
        return tau


@dataclass(frozen=True, slots=True)
class FrictionChange:
    """Friction goes to another value along a straight line, and stays; a soft contact's torsional friction in proportion.

    Args:
        mu: the coefficient at the end, ≥ 0.
        start, duration: s.
        finger: at one contact alone; at all by default.
    """

    mu: float
    start: float
    duration: float = 0.0
    finger: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "mu", arrays.check_number(self.mu, "mu", minimum=0.0))
        _check_times(self)

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """Set the friction of the step that begins at t; torques pass."""
        if t < self.start:
            return tau
        scene = plant.scene
        share = min((t - self.start) / self.duration, 1.0) if self.duration > 0.0 else 1.0
        for i, pair in enumerate(scene.contact_pairs):
            if self.finger in (None, scene.grasp.fingers[i]):
                before = scene.model.pair_friction[pair]
                after = before * (self.mu / before[0])
                plant.model.pair_friction[pair] = before + share * (after - before)
        return tau


@dataclass(frozen=True, slots=True)
class ContactLoss:
    """A finger is pulled off the object: a force on its tip along the outward normal, for a while.

    Args:
        finger: its name.
        pull: N; the finger leaves when it is more than it presses with.
        start, duration: s.
    """

    finger: str
    pull: float
    start: float
    duration: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "pull", arrays.check_number(self.pull, "pull", minimum=0.0))
        _check_times(self)

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """Add the pull to what acts on the finger's last link; torques pass."""
        grasp = plant.scene.grasp
        if self.finger not in grasp.fingers:
            raise UnknownName("finger", self.finger, grasp.fingers)
        if self.start <= t < self.start + self.duration:
            i = grasp.fingers.index(self.finger)
            body, geom = plant.scene.tip_bodies[i], plant.scene.tip_geoms[i]
            outward = -plant.object_motion().R_HO @ plant.true_contacts().R_OC[i, :, 2]
            arm = plant.data.geom_xpos[geom] - plant.data.xipos[body]  # m, from the link's mass centre to the tip
            force = self.pull * outward  # N
            plant.pull(body, force, cross(arm.tolist(), force.tolist()))
        return tau


@dataclass(frozen=True, slots=True)
class MotorFailure:
    """A motor that gives no torque any more; its joint moves freely.

    Args:
        joint: the name of the joint that it drives.
        start, duration: s; for ever by default.
    """

    joint: str
    start: float
    duration: float = math.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", arrays.check_number(self.start, "start", minimum=0.0))
        if not self.duration >= 0.0:
            raise InvalidInput("duration", self.duration, "at least 0")

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """The torques without this motor's."""
        names = [joint.name for joint in plant.scene.grasp.hand.joints]
        if self.joint not in names:
            raise UnknownName("joint", self.joint, names)
        if not self.start <= t < self.start + self.duration:
            return tau
        dead = np.array(tau)
        dead[names.index(self.joint)] = 0.0
        return dead


def _check_times(record: Push | FrictionChange | ContactLoss) -> None:
    for name in ("start", "duration"):
        object.__setattr__(record, name, arrays.check_number(getattr(record, name), name, minimum=0.0))
