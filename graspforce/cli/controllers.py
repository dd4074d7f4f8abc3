"""Controllers of measured input by name, and their settings, for one run and for the worker processes of a campaign."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy.typing as npt

from graspforce.control import ControlSettings, OutputFeedbackController
from graspforce.control.friction.friction_compensation import FrictionSettings
from graspforce.control.heat_protection import HeatProtectedController
from graspforce.core.errors import InvalidInput
from graspforce.estimation import SensorModel
from graspforce.grasp.grasp import Grasp
from graspforce.hand.hand import GRAVITY_PALM_UP
from graspforce.simulation import DirectController
from graspforce.simulation.campaigns.trial import ControllerFactory

ControllerName = Literal["estimate", "direct", "exact", "protected"]

CONTROLLER_NAMES: tuple[ControllerName, ...] = ("estimate", "direct", "exact", "protected")


@dataclass(frozen=True, slots=True)
class Assumptions:
    """Errors of its model that the controller plans for.

    Args:
        friction: as `ControlSettings.friction_error`.
        mass: as `ControlSettings.mass_error`.
        contact: as `ControlSettings.contact_error`, rad.
    """

    friction: float = 0.0
    mass: float = 0.0
    contact: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Assumptions:
        """Return the assumptions of an option such as friction=0.4,mass=0.5,contact=0.1.

        Args:
            text: names with values, separated by commas; "none" for no errors.

        Raises:
            InvalidInput: another form, or a value that `ControlSettings` does not allow.
        """
        names = [each.name for each in dataclasses.fields(cls)]
        values: dict[str, float] = {}
        for part in text.split(",") if text != "none" else ():
            name, _, number = part.partition("=")
            try:
                values[name] = float(number)
            except ValueError:
                values = {"": 0.0}
            if name not in names or "" in values:
                raise InvalidInput("--assume", part, "none, or friction=PART, mass=PART or contact=RAD, separated by commas")
        try:
            assumptions = cls(**values)
            assumptions.settings(GRAVITY_PALM_UP)
        except InvalidInput as error:
            raise error.with_prefix("--assume") from None
        return assumptions

    def settings(self, gravity_H: npt.ArrayLike, rate: float = 1000.0) -> ControlSettings:
        """Return the settings of a controller that compensates joint friction.

        Args:
            gravity_H: (3,) acceleration of gravity in H, m/s².
            rate: commands per second, Hz.
        """
        return ControlSettings(
            gravity_H=gravity_H,
            period=1.0 / rate,
            friction=FrictionSettings(),
            friction_error=self.friction,
            mass_error=self.mass,
            contact_error=self.contact,
        )


REAL_ASSUMPTIONS = Assumptions(friction=0.4, mass=0.5, contact=0.1)  # for the random worlds of `World.real`


def make_estimating_controller(grasp: Grasp, settings: ControlSettings, sensors: SensorModel) -> OutputFeedbackController:
    """Return the controller with an estimator, with the gains that its sensors permit.

    Args:
        grasp: the grasp, as told.
        settings: the other settings.
        sensors: noise, rate and latency of the sensors, as told.

    Raises:
        InvalidInput: no gains meet the requirements of `ControlSettings.for_sensors`.
    """
    gains = ControlSettings.for_sensors(sensors, settings, drives=grasp.hand.drives).settings
    return OutputFeedbackController(grasp, gains, sensors)


def make_direct_controller(grasp: Grasp, settings: ControlSettings, sensors: SensorModel) -> DirectController:
    """Return the controller without an estimator; see `DirectController`.

    Args:
        grasp: the grasp, as told.
        settings: settings of the controller.
        sensors: not used.
    """
    return DirectController(grasp, settings)


def make_protected_controller(grasp: Grasp, settings: ControlSettings, sensors: SensorModel) -> HeatProtectedController:
    """Return the controller with an estimator whose motors do not overheat; see `HeatProtectedController`.

    Args:
        grasp: the grasp, as told.
        settings: the other settings.
        sensors: noise, rate and latency of the sensors, as told.

    Raises:
        InvalidInput: a drive lacks thermal data, or no gains meet the requirements of `ControlSettings.for_sensors`.
    """
    gains = ControlSettings.for_sensors(sensors, settings, drives=grasp.hand.drives).settings
    return HeatProtectedController(grasp, gains, sensors)


# "exact" needs the plant
FACTORIES: dict[str, ControllerFactory] = {
    "estimate": make_estimating_controller,
    "direct": make_direct_controller,
    "protected": make_protected_controller,
}
