"""Control with protected motors: torque limits and the cost of torques follow the temperatures of the windings.

The temperatures are estimated from the currents (`graspforce.hand.heat`). Every interval the controller continues with the hand
of the present temperatures: no torque can overheat a winding, and the forces move from fingers with hot motors to cool ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from graspforce.control.command import Command
from graspforce.control.output_feedback import OutputFeedbackController
from graspforce.control.settings import ControlSettings
from graspforce.control.state import DesiredMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.estimation.estimate import GraspEstimate
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.sensor_model import SensorModel
from graspforce.grasp.grasp import Grasp
from graspforce.hand.heat import AMBIENT, MotorTemperatures, ThermalModel, hottest_finger

_LEAST_FRACTION = 0.02  # of the hand's torque limit: a motor that is too hot keeps it, and cools


@dataclass(frozen=True, slots=True)
class HeatSettings:
    """Settings of the protection.

    Args:
        interval: time between two updates of the torque limits, s. Keep it below a tenth of the windings' time constants.
        ambient: temperature of the air, °C.
        reserve: part of the temperature range over the air that is kept free, in [0, 1), for errors of the thermal data.
        balances: whether the cost of a torque grows with the temperature of its motor, so that hot fingers rest.

    Raises:
        InvalidInput: a value is out of range.
    """

    interval: float = 0.5
    ambient: float = AMBIENT
    reserve: float = 0.1
    balances: bool = True

    def __post_init__(self) -> None:
        arrays.check_number(self.interval, "interval", above=0.0)
        arrays.check_number(self.reserve, "reserve", minimum=0.0)


class HeatProtectedController:
    """`OutputFeedbackController` whose motors do not overheat. Call `step` once every period.

    Args:
        grasp: hand with drives of known thermal data, object and contacts.
        settings: as in `OutputFeedbackController`.
        sensors: as in `OutputFeedbackController`.
        heat: settings of the protection.
        temperatures: of the motors at the start. Default: that of the air.

    Attributes:
        temperatures: estimated temperatures of the motors.

    Raises:
        InvalidInput: a drive lacks thermal data; names it.
    """

    def __init__(
        self,
        grasp: Grasp,
        settings: ControlSettings | None = None,
        sensors: SensorModel | None = None,
        heat: HeatSettings | None = None,
        temperatures: MotorTemperatures | None = None,
    ) -> None:
        self._grasp, self._heat = grasp, heat or HeatSettings()
        self._model = ThermalModel(grasp.hand.drives, self._heat.ambient).with_reserve(self._heat.reserve)
        self._controller = OutputFeedbackController(grasp, settings, sensors)
        self._start = temperatures or self._model.at_rest()
        self.reset()

    @property
    def estimate(self) -> GraspEstimate | None:
        """The estimate of the last step; None before the first."""
        return self._controller.estimate

    def reset(self) -> None:
        """Forget everything, as before the first step; the motors have the temperatures of the start."""
        self._controller.reset()
        self.temperatures, self._squares, self._count = self._start, np.zeros(self._grasp.hand.n), 0
        self._last = np.zeros(self._grasp.hand.n)  # N·m
        self._controller.continue_with(self._limited_grasp())

    def step(
        self,
        measurement: Measurement,
        desired: DesiredMotion,
        external: npt.ArrayLike | None = None,
        *,
        lost: Sequence[str] = (),
    ) -> Command:
        """Compute the command for the next period.

        The currents are those of the measurement. Without them, they are those of the torques of the last command.

        Args:
            measurement: as in `OutputFeedbackController.step`.
            desired: as in `OutputFeedbackController.step`.
            external: as in `OutputFeedbackController.step`.
            lost: as in `OutputFeedbackController.step`.

        Raises:
            InvalidInput: as in `OutputFeedbackController.step`.
            UnknownName: as in `OutputFeedbackController.step`.
        """
        current = self._model.currents(self._last) if measurement.current is None else measurement.current
        self._squares, self._count = self._squares + np.square(current), self._count + 1
        time = self._count * self._controller.settings.period
        if time >= self._heat.interval:
            self.temperatures = self._model.step(self.temperatures, np.sqrt(self._squares / self._count), time)
            self._squares, self._count = np.zeros(self._grasp.hand.n), 0
            self._controller.continue_with(self._limited_grasp())
        command = self._controller.step(measurement, desired, external, lost=lost)
        self._last = command.tau
        return command

    def hold_times(self) -> Array:
        """Return how long each motor can bear the torques of the last command, (n,), s; infinite if forever."""
        return self._model.hold_times(self.temperatures, self._last)

    def finger_to_rest(self) -> str | None:
        """Return the finger whose motors overheat first under the torques of the last command; None if none does."""
        return hottest_finger(self._grasp.hand, self.hold_times(), self._grasp.fingers)

    def _limited_grasp(self) -> Grasp:
        """Return the grasp with the torque limits and the cost of the present temperatures."""
        hand = self._grasp.hand
        limits = np.maximum(self._model.torque_limits(self.temperatures), _LEAST_FRACTION * hand.torque_upper)
        weight = self._model.torque_weight(self.temperatures) if self._heat.balances else None
        return replace(self._grasp, hand=hand.with_torque_limits(limits, weight))
