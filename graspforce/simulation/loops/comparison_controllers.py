"""Controllers to compare with: one that knows the truth, and one that uses measurements without an estimator.

Both follow `MeasuredController`, so that `simulate_measured` runs them in the same world as any other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from graspforce.contact.contact import ContactModel, ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control.command import Command
from graspforce.control.drives.drive_commands import DriveCommand, DriveMap
from graspforce.control.friction.friction_compensation import FrictionSettings
from graspforce.control.object_controller import ObjectController
from graspforce.control.settings import ControlSettings
from graspforce.control.state import DesiredMotion, GraspMotion, GraspState, object_motion
from graspforce.core.arrays import Array, freeze
from graspforce.estimation.measurement import Measurement, PoseMeasurement
from graspforce.estimation.sensor_model import SensorModel
from graspforce.geometry.rotations import rotation_log
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.plants.driven_plant import DrivenPlant
from graspforce.simulation.plants.plant_interface import PlantInterface
from graspforce.simulation.plants.plant_options import PlantOptions
from graspforce.simulation.worlds.true_grasp import read_true_grasp
from graspforce.simulation.worlds.world import World

_SPIN_FRICTION = 0.2  # part of the friction that is left to moments about the normals, where they are not planned
_LEAST_GAIN = 1e-3  # of a motor that is corrected for
_BANDWIDTH = 100.0  # rad/s, of the low-pass filter of differenced measurements


@dataclass(frozen=True, eq=False, slots=True)
class CorrectedCommand:
    """A command with torques that are corrected for the motors, and contacts in O. Fields as in `Command`."""

    tau: Array
    drive: DriveCommand
    f: Array
    contacts: ContactSet
    error: Array
    slip_margin: Array
    saturated: bool
    forces_reused: bool
    warnings: tuple[str, ...]


class ExactController:
    """The object controller with full knowledge of a world: what can be held by it is possible in that world.

    It reads the plant's exact state, and knows the true hand, object, contacts, joint friction and motors. Joint friction is
    compensated along the planned motion, and the slip margin covers the friction of joints at rest, whose direction is not
    known. The delay of the loop remains.

    Args:
        grasp: the grasp that other controllers are told.
        options: true parameters of the plant.
        settings: settings of the controller, such as `exact_settings`.
        plant: the plant; it is reset.
        plan_spin: whether soft contacts roll without spin. Joints can reach their limits by that. Otherwise soft contacts are
            controlled as point contacts with less friction, and may spin. Default: without spin, unless that blocks motions of
            the object.

    Raises:
        InvalidInput: as in `read_true_grasp`.
    """

    estimate: None = None

    def __init__(
        self,
        grasp: Grasp,
        options: PlantOptions,
        settings: ControlSettings,
        plant: PlantInterface,
        *,
        plan_spin: bool | None = None,
    ) -> None:
        drives, inner = grasp.hand.drives, plant
        if isinstance(plant, DrivenPlant):
            drives, inner = plant.drives, plant.plant
        self._true, self._plant = read_true_grasp(inner, grasp, options), plant
        true = self._true.grasp
        if plan_spin is not True:
            true = _controllable_grasp(true, settings) if plan_spin is None else _with_points(true)
        if true.hand.friction.coulomb.any():
            coulomb = float(true.hand.friction.coulomb.mean())  # N·m
            settings = replace(settings, friction=FrictionSettings(torque_error=coulomb))
        error = 0.0 if true is self._true.grasp else _SPIN_FRICTION
        settings = replace(settings, friction_error=error, mass_error=0.0, contact_error=0.0)
        self._controller = ObjectController(true, settings)
        self._drives = DriveMap(true.hand.with_drives(drives.joints))
        self._gain = np.maximum(options.per_joint("torque_gain", grasp.hand.n), _LEAST_GAIN)

    def reset(self) -> None:
        """Return to the start of the grasp."""
        self._controller.reset()

    def step(self, measurement: Measurement, desired: DesiredMotion, *, lost: Sequence[str] = ()) -> CorrectedCommand:
        """Return the command for the plant's exact state.

        Args:
            measurement: not used.
            desired: the desired motion of O.
            lost: names of fingers whose drives are off.
        """
        true, state = self._true, self._plant.state()
        state = GraspState(state.q, state.v, true.to_surface(state.object))
        body = true.to_surface(object_motion(desired))
        target = GraspMotion(body, desired.q, desired.v, desired.a) if isinstance(desired, GraspMotion) else body
        command = self._controller.step(state, target, lost=lost)
        tau = command.tau / self._gain
        return CorrectedCommand(
            tau=tau,
            drive=self._drives.set_points(tau, state.q, state.v),
            f=command.f,
            contacts=true.contacts_in_O(command.contacts),
            error=command.error,
            slip_margin=command.slip_margin,
            saturated=command.saturated,
            forces_reused=command.forces_reused,
            warnings=command.warnings,
        )


def _controllable_grasp(grasp: Grasp, settings: ControlSettings) -> Grasp:
    """Return a grasp with point contacts if its soft contacts would block motions of the object that point contacts permit.

    Soft contacts also roll without spin. Fingers with three joints cannot follow all motions of an object with such contacts.
    """
    start = BodyMotion(grasp.p_HO, grasp.R_HO)
    state = GraspState(grasp.q, np.zeros(grasp.hand.n), start)
    candidates = [grasp, _with_points(grasp)]
    blocked = [len(ObjectController(each, settings).step(state, start).uncontrollable) for each in candidates]
    return candidates[1] if blocked[1] < blocked[0] else grasp


def _with_points(grasp: Grasp) -> Grasp:
    """Return a grasp with point contacts."""
    points = (ContactModel.POINT,) * len(grasp.contacts)
    return replace(grasp, contacts=replace(grasp.contacts, models=points, gamma=freeze(np.zeros(len(points)))))


def exact_settings(settings: ControlSettings, world: World, grasp: Grasp) -> ControlSettings:
    """Return settings for `ExactController` with the fastest gains that the rate and the delay of a world permit.

    Args:
        settings: the other settings.
        world: the world.
        grasp: the grasp; the drives of its hand bound the gains, too.

    Raises:
        InvalidInput: no gains are stable with this delay.
    """
    sensors = SensorModel(rate=world.sensors.rate, latency=world.sensors.latency, has_velocity=True)
    return ControlSettings.for_sensors(sensors, settings, drives=grasp.hand.drives).settings


class DirectController:
    """The object controller with measurements as they come: the newest pose, and differenced, low-passed rates.

    This is what a user gets without an estimator. Before the first pose, the object has the pose of the grasp.

    Args:
        grasp: the grasp, as told.
        settings: settings of the controller.
    """

    def __init__(self, grasp: Grasp, settings: ControlSettings) -> None:
        self._grasp, self._controller = grasp, ObjectController(grasp, settings)
        self.reset()

    def reset(self) -> None:
        """Forget all measurements."""
        self._controller.reset()
        self._last: Measurement | None = None
        self._pose: PoseMeasurement | None = None
        self._v, self._twist = np.zeros(self._grasp.hand.n), np.zeros(6)
        self.estimate: GraspState | None = None

    def step(self, measurement: Measurement, desired: DesiredMotion, *, lost: Sequence[str] = ()) -> Command:
        """Return the command for a measurement.

        Args:
            measurement: the newest measurement.
            desired: the desired motion.
            lost: names of fingers whose drives are off.
        """
        if measurement.v is not None:
            self._v = np.array(measurement.v)
        elif self._last is not None:
            dt = measurement.t - self._last.t
            self._v = _low_pass(self._v, (measurement.q - self._last.q) / dt, dt)
        self._last = measurement
        if measurement.object is not None:
            if self._pose is not None:
                dt = measurement.object.t - self._pose.t
                turned = rotation_log(measurement.object.R_HO @ self._pose.R_HO.T)  # rad
                moved = np.append(measurement.object.p_HO - self._pose.p_HO, turned)
                self._twist = _low_pass(self._twist, moved / dt, dt)
            self._pose = measurement.object
        pose = self._pose or self._grasp
        self.estimate = GraspState(measurement.q, self._v, BodyMotion(pose.p_HO, pose.R_HO, self._twist))
        return self._controller.step(self.estimate, desired, lost=lost)


def _low_pass(last: Array, new: Array, dt: float) -> Array:
    """Return the output of a first-order low-pass filter after dt in s."""
    return np.asarray(new + math.exp(-_BANDWIDTH * dt) * (last - new))
