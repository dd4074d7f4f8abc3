"""Disturbances of the plant: pushes, mass and friction changes, lost contacts, failed motors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.core.records import set_fields
from graspforce.geometry.vectors import cross
from graspforce.simulation.plants.plant import Plant


@dataclass(frozen=True, eq=False, slots=True)
class Push:
    """A constant force on the object for a time.

    Args:
        force: (3,) in H, N.
        start: begin, s.
        duration: length, s.
        point: (3,) point of action in O, m. Default: O's origin.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    force: Array
    start: float
    duration: float
    point: Array = field(default_factory=lambda: freeze(np.zeros(3)))

    if TYPE_CHECKING:  # the constructor accepts more types than the fields have

        def __init__(self, force: npt.ArrayLike, start: float, duration: float, point: npt.ArrayLike = ...) -> None: ...

    def __post_init__(self) -> None:
        force, point = arrays.check_array(self.force, "force", (3,)), arrays.check_array(self.point, "point", (3,))
        set_fields(self, force=force, point=point)
        _check_times(self)

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """Add the force to those on the object. See `Disturbance.apply`."""
        if self.start <= t < self.start + self.duration:
            offset = self.point - plant.model.body_ipos[plant.scene.object_body]  # m, from the centre of mass, in O
            arm = plant.object_motion().R_HO @ offset
            plant.add_wrench(plant.scene.object_body, self.force, cross(arm.tolist(), self.force.tolist()))
        return tau


@dataclass(frozen=True, slots=True)
class MassChange:
    """A permanent change of the object's mass and inertia by a factor.

    For a mass that differs from the grasp's from the beginning, use `body` of `build_scene`.

    Args:
        factor: of mass and inertia, > 0.
        start: time of the change, s.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    factor: float
    start: float

    def __post_init__(self) -> None:
        factor = arrays.check_number(self.factor, "factor", above=0.0)
        set_fields(self, factor=factor, start=arrays.check_number(self.start, "start", minimum=0.0))

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """Change the plant's model in the first step from `start` on. See `Disturbance.apply`."""
        if self.start <= t < self.start + plant.dt:
            plant.model.body_mass[plant.scene.object_body] *= self.factor
            plant.model.body_inertia[plant.scene.object_body] *= self.factor
            mujoco.mj_setConst(plant.model, mujoco.MjData(plant.model))
        return tau


@dataclass(frozen=True, slots=True)
class FrictionChange:
    """A permanent linear change of friction; torsional friction changes in proportion.

    Args:
        mu: final coefficient, ≥ 0.
        start: begin, s.
        duration: length of the change, s.
        finger: name of the only finger whose contact changes. Default: all contacts.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    mu: float
    start: float
    duration: float = 0.0
    finger: str | None = None

    def __post_init__(self) -> None:
        set_fields(self, mu=arrays.check_number(self.mu, "mu", minimum=0.0))
        _check_times(self)

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """Set the friction of the step. See `Disturbance.apply`."""
        if t < self.start:
            return tau
        scene = plant.scene
        share = min((t - self.start) / self.duration, 1.0) if self.duration > 0.0 else 1.0
        for i, pair in enumerate(scene.contact_pairs):
            if self.finger in (None, scene.grasp.fingers[i]):
                initial = scene.model.pair_friction[pair]
                final = initial * (self.mu / initial[0])
                plant.model.pair_friction[pair] = initial + share * (final - initial)
        return tau


@dataclass(frozen=True, slots=True)
class ContactLoss:
    """A force that pulls a fingertip off the object, along the outward normal.

    Args:
        finger: name of the finger.
        pull_force: size of the force, N, ≥ 0; the contact opens if it exceeds the normal force.
        start: begin, s.
        duration: length, s.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    finger: str
    pull_force: float
    start: float
    duration: float

    def __post_init__(self) -> None:
        set_fields(self, pull_force=arrays.check_number(self.pull_force, "pull_force", minimum=0.0))
        _check_times(self)

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """Add the force to those on the finger's last link. See `Disturbance.apply`."""
        grasp = plant.scene.grasp
        if self.finger not in grasp.fingers:
            raise UnknownName("finger", self.finger, grasp.fingers)
        if self.start <= t < self.start + self.duration:
            i = grasp.fingers.index(self.finger)
            body, geom = plant.scene.tip_bodies[i], plant.scene.tip_geoms[i]
            outward = -plant.object_motion().R_HO @ plant.true_contacts().R_OC[i, :, 2]
            arm = plant.data.geom_xpos[geom] - plant.data.xipos[body]  # m, from the link's centre of mass to the tip
            force = self.pull_force * outward  # N
            plant.add_wrench(body, force, cross(arm.tolist(), force.tolist()))
        return tau


@dataclass(frozen=True, slots=True)
class MotorFailure:
    """A motor without torque; its joint moves freely.

    Args:
        joint: name of the motor's joint.
        start: begin, s.
        duration: length, s. Default: permanent.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    joint: str
    start: float
    duration: float = math.inf

    def __post_init__(self) -> None:
        set_fields(self, start=arrays.check_number(self.start, "start", minimum=0.0))
        if not self.duration >= 0.0:
            raise InvalidInput("duration", self.duration, "a number ≥ 0")

    def apply(self, plant: Plant, t: float, tau: Array) -> Array:
        """Return the torques, with zero for the failed motor. See `Disturbance.apply`."""
        names = [joint.name for joint in plant.scene.grasp.hand.joints]
        if self.joint not in names:
            raise UnknownName("joint", self.joint, names)
        if not self.start <= t < self.start + self.duration:
            return tau
        remaining = np.array(tau)
        remaining[names.index(self.joint)] = 0.0
        return remaining


def _check_times(record: Push | FrictionChange | ContactLoss) -> None:
    """Check `start` and `duration`: numbers ≥ 0."""
    for name in ("start", "duration"):
        set_fields(record, **{name: arrays.check_number(getattr(record, name), name, minimum=0.0)})
