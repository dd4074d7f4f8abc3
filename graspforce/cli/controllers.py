"""Controllers of measured input, by name, for one run and for the worker processes of a campaign."""

from __future__ import annotations

from typing import Literal

from graspforce.control import ControlSettings, OutputFeedbackController
from graspforce.estimation import SensorModel
from graspforce.grasp.grasp import Grasp
from graspforce.simulation import DirectController
from graspforce.simulation.campaign_trial import ControllerFactory

ControllerName = Literal["estimate", "direct", "exact"]

CONTROLLER_NAMES: tuple[ControllerName, ...] = ("estimate", "direct", "exact")


def make_direct_controller(grasp: Grasp, settings: ControlSettings, sensors: SensorModel) -> DirectController:
    """Return the controller without an estimator; see `DirectController`.

    Args:
        grasp: the grasp, as told.
        settings: settings of the controller.
        sensors: not used.
    """
    return DirectController(grasp, settings)


# "exact" needs the plant
FACTORIES: dict[str, ControllerFactory] = {"estimate": OutputFeedbackController, "direct": make_direct_controller}
