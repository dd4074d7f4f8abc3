"""Inputs and outputs of a phase of a grasp in one control period."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy.typing as npt

from graspforce.contact.contact import ContactSet
from graspforce.control.drives.drive_commands import DriveCommand, DriveMap
from graspforce.control.phases.cycle_plan import BaseMotion
from graspforce.control.phases.finger_servo import ServoMemory, ServoStep
from graspforce.control.phases.phase_rules import PhaseName
from graspforce.control.state import DesiredMotion
from graspforce.core.arrays import Array
from graspforce.estimation.measurement import Measurement
from graspforce.grasp.grasp import Grasp


class ObjectCommand(Protocol):
    """The fields of a command of an object controller that the phases use, as in `graspforce.control.Command`."""

    @property
    def tau(self) -> Array: ...  # pragma: no cover
    @property
    def f(self) -> Array: ...  # pragma: no cover
    @property
    def contacts(self) -> ContactSet: ...  # pragma: no cover
    @property
    def slip_margin(self) -> Array: ...  # pragma: no cover
    @property
    def forces_reused(self) -> bool: ...  # pragma: no cover


class FeedbackController(Protocol):
    """A controller of a held object that knows measurements only, such as `graspforce.control.OutputFeedbackController`."""

    def step(self, measurement: Measurement, desired: DesiredMotion, external: npt.ArrayLike | None = None) -> ObjectCommand:
        """Return the command of a control period.

        Args:
            measurement: the newest measurement.
            desired: the desired motion at the time of the measurement.
            external: (6,) wrench on the object that comes neither from gravity nor from the fingers, about O's origin, in O,
                N and N·m.
        """
        ...  # pragma: no cover


class PhaseTorques(NamedTuple):
    """Result of a phase in one period.

    Attributes:
        tau: (n,) joint torques, N·m.
        servo: result of the servo, and its memory.
        base: motion of the hand's base.
        is_over: whether the phase has reached its exit condition.
        abort: reason to stop the cycle; empty for none.
        command: command of the object controller; None in phases without it.
        share: part of the planned forces that the fingers apply, 0 to 1.
    """

    tau: Array
    servo: tuple[ServoStep, ServoMemory]
    base: BaseMotion
    is_over: bool = False
    abort: str = ""
    command: ObjectCommand | None = None
    share: float = 0.0


@dataclass(frozen=True, eq=False, slots=True)
class PhaseCommand:
    """Command of a control period.

    Attributes:
        t: time of the measurement since the start of the cycle, s.
        phase: the phase that made the command.
        tau: (n,) joint torques, N·m.
        base: motion of the hand's base, for the arm.
        touching: (N,) signs of contact of the guarded close, see `ContactSign`; empty for fingers without.
        f_normal: (N,) planned normal forces, N; zero in phases without planned forces.
        slip_margin: least slip margin of the planned forces, N; NaN without planned forces.
        message: why the cycle has stopped, or why the fingers open for another attempt; empty otherwise.
        joints: estimated positions, rad, and rates, rad/s, of the joints when the torques act, each (n,).
        drives: map from torques to what the drives take.
    """

    t: float
    phase: PhaseName
    tau: Array
    base: BaseMotion
    touching: tuple[str, ...]
    f_normal: Array
    slip_margin: float
    message: str
    joints: tuple[Array, Array]
    drives: DriveMap

    @property
    def drive(self) -> DriveCommand:
        """Set-points of the drives."""
        return self.drives.set_points(self.tau, *self.joints)


@dataclass(frozen=True, eq=False, slots=True)
class PhaseRecord:
    """A phase that has ended.

    Attributes:
        phase: its name.
        start: time of its first step, s.
        end: time of its last step, s.
        reason: exit condition, or reason of the abort.
        is_aborted: whether it ended by an abort.
        grasp: the grasp as known at its end.
    """

    phase: PhaseName
    start: float
    end: float
    reason: str
    is_aborted: bool
    grasp: Grasp
