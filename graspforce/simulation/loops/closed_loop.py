"""The closed loop: measure, control, step, record."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy.typing as npt

from graspforce.contact.motion import BodyMotion
from graspforce.control.state import DesiredMotion, GraspState, object_motion
from graspforce.core import arrays
from graspforce.core.errors import InvalidInput
from graspforce.simulation.loops.reference import Reference
from graspforce.simulation.plants.driven_plant import step_plant
from graspforce.simulation.plants.plant_interface import PlantInterface
from graspforce.simulation.recordings.recording import Recording
from graspforce.simulation.recordings.recording_builder import ControllerCommand, RecordingBuilder
from graspforce.simulation.sensors.sensor_models import SensorReader, Sensors

PlantT = TypeVar("PlantT", bound=PlantInterface)


class Controller(Protocol):
    """A controller, such as `graspforce.control.ObjectController`."""

    def step(self, state: GraspState, desired: DesiredMotion, external: npt.ArrayLike | None = None) -> ControllerCommand:
        """Return the command of a control period.

        Args:
            state: the measured state.
            desired: the desired motion.
            external: (6,) known external wrench on the object, N and N·m.
        """
        ...  # pragma: no cover


def simulate(
    plant: PlantT,
    controller: Controller,
    reference: Reference,
    duration: float,
    *,
    initial_forces: npt.ArrayLike | None = None,
    sensors: Sensors | None = None,
    on_step: Callable[[PlantT, ControllerCommand], bool | None] | None = None,
) -> Recording:
    """Simulate the closed loop, from the plant's grasp with preloaded contacts.

    Args:
        plant: any plant; it is reset.
        controller: the controller, without history of an earlier run.
        reference: desired motion as a function of time in s.
        duration: simulated time, s.
        initial_forces: (k,) contact forces at t = 0, N and N·m. Default: the forces of the controller's first command. The
            controller computes it at rest, and is then reset if it has a method `reset`.
        sensors: sensor models. Default: perfect sensors.
        on_step: called after each step; if it returns False, the run ends. An exception that it raises ends the run, too.

    Returns:
        The recording of all steps.

    Raises:
        InvalidInput: the duration is shorter than a step.
    """
    grasp = plant.grasp
    steps = round(arrays.check_number(duration, "duration", above=0.0) / plant.dt)
    if steps < 1:
        raise InvalidInput("duration", duration, f"at least one step, {plant.dt:g} s")
    reader = SensorReader(sensors or Sensors(), plant.dt)
    if initial_forces is None:
        first = controller.step(plant.reset(), BodyMotion(grasp.p_HO, grasp.R_HO))
        initial_forces = None if first.forces_reused else first.f
        if hasattr(controller, "reset"):
            controller.reset()
    state = plant.reset(initial_forces)
    builder = RecordingBuilder()
    for k in range(steps):
        t = k * plant.dt
        desired = reference(t)
        command = controller.step(reader.read(state), desired)
        builder.add_inputs(t, state, object_motion(desired), command)
        state = step_plant(plant, command)
        builder.add_results(plant)
        if on_step is not None and on_step(plant, command) is False:
            break
    return builder.finish(grasp)
