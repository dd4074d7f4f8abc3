"""A plant whose joints have drives: set-points in, torques of servos, currents and gears at the joints.

Each step the true drives turn the newest set-points that they took into torques. Their constants may differ from those that the
controller knows. Losses of a gear depend on its load: with the motor's torque m, it passes m η while the motor drives and m/η_b
while the joint drives it. The plant gets the mean of both, and half of their difference as Coulomb friction of the joint.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

import numpy as np
import numpy.typing as npt

from graspforce.control.drives.drive_commands import DriveCommand
from graspforce.control.state import GraspState
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.hand.drives.drive import POSITION_MODES, Drives
from graspforce.simulation.plants.plant import Plant
from graspforce.simulation.plants.plant_interface import PlantInterface, TrueContacts
from graspforce.simulation.plants.urdf_plant import UrdfPlant

_ROUNDING = 1e-9  # of the number of set-points taken
_SET_POINTS = ("torque", "current", "position", "velocity", "stiffness", "damping", "current_limit")


class DriveModel:
    """The drives of n joints in motion: set-points that arrive late, rarely and rounded, and the torques that they make.

    Args:
        drives: the true drives.
        dt: time between two calls of `step`, s.
    """

    def __init__(self, drives: Drives, dt: float) -> None:
        self._delay = np.rint(drives.values("delay") / dt).astype(int)
        self._samples = np.minimum(drives.values("rate") * dt, 1.0)  # set-points that are taken in a step
        self._resolution, self._backlash = drives.values("resolution"), drives.values("backlash")
        self._k, self._K, self._D = (drives.values(name) for name in ("torque_constant", "stiffness", "damping"))
        self._gain, self._loss = drives.gear_gain, drives.gear_loss
        self._largest_current = drives.values("current_limit")
        self._is_current, self._is_impedance = drives.has_mode("current"), drives.has_mode("impedance")
        self._is_servo = drives.has_mode("position", "position_with_current_limit")
        self._is_limited = drives.has_mode("position_with_current_limit")
        self._takes_position = drives.has_mode(*POSITION_MODES)
        self.reset()

    def reset(self) -> None:
        """Forget all set-points."""
        self._history: deque[Array] = deque(maxlen=1 + int(self._delay.max(initial=0)))
        self._active: Array | None = None
        self._count = 0

    def step(self, command: DriveCommand, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return the joint torques of a step, the Coulomb friction of the gears, and the motor currents.

        Args:
            command: set-points that arrive at the drives in this step.
            q: (n,) joint positions, rad.
            v: (n,) joint rates, rad/s.

        Returns:
            Three arrays (n,): torques, N·m; friction, N·m; currents, A, NaN without a torque constant.
        """
        self._history.append(self._quantise(command))
        newest = len(self._history) - 1
        rows = np.maximum(newest - self._delay, 0)
        arrived = np.stack(self._history)[rows, :, np.arange(len(q))].T
        if self._active is None:
            self._active = arrived
        is_taken = np.floor(self._count * self._samples + _ROUNDING) > np.floor((self._count - 1) * self._samples + _ROUNDING)
        self._active = np.where(is_taken, arrived, self._active)
        self._count += 1
        torque, current, position, velocity, stiffness, damping, current_limit = self._active
        error = position - q  # rad
        error = np.sign(error) * np.maximum(np.abs(error) - 0.5 * self._backlash, 0.0)
        m = np.where(self._is_current, self._k * current, torque)  # N·m
        m = np.where(self._is_impedance, torque + stiffness * error + damping * (velocity - v), m)
        m = np.where(self._is_servo, self._K * error - self._D * v, m)
        limit = np.where(self._is_limited, np.minimum(current_limit, self._largest_current), self._largest_current)  # A
        largest = np.where(np.isfinite(limit), np.nan_to_num(self._k) * np.where(np.isfinite(limit), limit, 0.0), np.inf)
        m = np.clip(m, -largest, largest)
        return self._gain * m, self._loss * np.abs(m), m / self._k

    def _quantise(self, command: DriveCommand) -> Array:
        """Return the set-points as (7, n), rounded to the resolution of the drives."""
        values = np.array([getattr(command, name) for name in _SET_POINTS])
        main = np.where(self._takes_position, 2, np.where(self._is_current, 1, 0))
        columns = np.flatnonzero(self._resolution > 0.0)
        step = self._resolution[columns]
        values[main[columns], columns] = step * np.round(values[main[columns], columns] / step)
        return values


class DrivenPlant:
    """A plant whose joints have drives.

    Args:
        plant: the plant of hand and object.
        drives: its true drives.

    Attributes:
        plant: as given.
        drives: as given.
        current: (n,) motor currents of the last step, A; NaN where the torque constant is unknown.

    Raises:
        InvalidInput: another number of drives than joints.
    """

    def __init__(self, plant: Plant | UrdfPlant, drives: Drives) -> None:
        n = plant.grasp.hand.n
        if len(drives) != n:
            raise InvalidInput("drives", f"{len(drives)} drives", f"one for each of the {n} actuated joints")
        self.plant, self.drives = plant, drives
        self._model = DriveModel(drives, plant.dt)
        self.current = np.zeros(n)

    @property
    def grasp(self) -> Grasp:
        """The grasp in which the plant starts."""
        return self.plant.grasp

    @property
    def dt(self) -> float:
        """Length of a step, s."""
        return self.plant.dt

    @property
    def t(self) -> float:
        """Time since the reset, s."""
        return self.plant.t

    def reset(self, f: npt.ArrayLike | None = None) -> GraspState:
        """Return to the grasp, at rest, as the plant does, and forget all set-points.

        Args:
            f: (k,) stacked contact forces, N and N·m. Default: the plant's own choice.
        """
        self._model.reset()
        self.plant.set_gear_friction(np.zeros(self.grasp.hand.n))
        return self.plant.reset(f)

    def step(self, tau: npt.ArrayLike) -> GraspState:
        """Advance by dt under joint torques, without the drives.

        Args:
            tau: (n,) torques, N·m.
        """
        return self.plant.step(arrays.check_array(tau, "tau", (self.grasp.hand.n,)))

    def step_drives(self, command: DriveCommand, powered: Array | None = None) -> GraspState:
        """Advance by dt with set-points of the drives, and return the true state at the end of the step.

        Args:
            command: set-points that arrive at the drives in this step.
            powered: (n,) 0 for drives that are off, 1 for others. Default: all are on.
        """
        state = self.plant.state()
        power = 1.0 if powered is None else powered
        tau, friction, current = self._model.step(command, state.q, state.v)
        self.current = power * current
        self.plant.set_gear_friction(power * friction)
        return self.plant.step(power * tau)

    def state(self) -> GraspState:
        """Return the true state."""
        return self.plant.state()

    def true_contacts(self) -> TrueContacts:
        """Return the contacts of the last step."""
        return self.plant.true_contacts()


class PlantCommand(Protocol):
    """The fields of a command that a plant takes."""

    @property
    def tau(self) -> Array:
        """(n,) joint torques, N·m."""
        ...  # pragma: no cover

    @property
    def drive(self) -> DriveCommand:
        """Set-points of the drives."""
        ...  # pragma: no cover


def step_plant(plant: PlantInterface, command: PlantCommand, powered: Array | None = None) -> GraspState:
    """Advance a plant by dt, and return the true state: with set-points if its joints have drives, otherwise with torques.

    Args:
        plant: the plant.
        command: torques and set-points.
        powered: (n,) 0 for joints whose drives are off, 1 for others. Default: all are on.
    """
    if isinstance(plant, DrivenPlant):
        return plant.step_drives(command.drive, powered)
    return plant.step(command.tau if powered is None else powered * command.tau)
