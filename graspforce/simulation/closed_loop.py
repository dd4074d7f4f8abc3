"""The closed loop: measure, control, step, record."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control.state import DesiredMotion, GraspState, object_motion
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.simulation.plant_interface import PlantInterface
from graspforce.simulation.recording import Recording
from graspforce.simulation.reference import Reference
from graspforce.simulation.sensors import SensorReader, Sensors

PlantT = TypeVar("PlantT", bound=PlantInterface)


class ControllerCommand(Protocol):
    """The fields of a command that the loop reads, as in `graspforce.control.Command` and in a command of a stream."""

    @property
    def tau(self) -> Array: ...  # pragma: no cover
    @property
    def f(self) -> Array: ...  # pragma: no cover
    @property
    def contacts(self) -> ContactSet: ...  # pragma: no cover
    @property
    def error(self) -> Array: ...  # pragma: no cover
    @property
    def slip_margin(self) -> Array: ...  # pragma: no cover
    @property
    def saturated(self) -> bool: ...  # pragma: no cover
    @property
    def forces_reused(self) -> bool: ...  # pragma: no cover
    @property
    def warnings(self) -> tuple[str, ...]: ...  # pragma: no cover


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
    on_step: Callable[[PlantT, ControllerCommand], None] | None = None,
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
        on_step: called after each step. An exception that it raises ends the run.

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
    builder = _RecordingBuilder()
    for k in range(steps):
        t = k * plant.dt
        desired = reference(t)
        command = controller.step(reader.read(state), desired)
        builder.add_inputs(t, state, object_motion(desired), command)
        state = plant.step(command.tau)
        builder.add_results(plant)
        if on_step is not None:
            on_step(plant, command)
    hand = grasp.hand
    return Recording(
        hand=hand.name,
        fingers=grasp.fingers,
        joints=tuple(joint.name for joint in hand.joints),
        warnings=tuple(builder.warnings),
        torque_lower=hand.torque_lower,
        torque_upper=hand.torque_upper,
        **{name: freeze(values) for name, values in builder.values.items()},
    )


class _RecordingBuilder:
    """The rows of a recording during the simulation."""

    def __init__(self) -> None:
        self.values: dict[str, list[Any]] = {}
        self.warnings: list[tuple[float, str]] = []
        self._last_warnings: set[str] = set()

    def _add(self, **row: object) -> None:
        for name, value in row.items():
            self.values.setdefault(name, []).append(value)

    def add_inputs(self, t: float, state: GraspState, desired: BodyMotion, command: ControllerCommand) -> None:
        """Add the true state, the desired motion and the command of a step."""
        motion = state.object
        self._add(t=t, q=state.q, v=state.v, p_HO=motion.p_HO, R_HO=motion.R_HO, twist=motion.twist)
        self._add(p_desired=desired.p_HO, R_desired=desired.R_HO, twist_desired=desired.twist)
        planned: Array = command.contacts.pad(np.asarray(command.f))
        self._add(tau_command=command.tau, planned=planned, planned_R_OC=command.contacts.R_OC)
        self._add(planned_margin=command.slip_margin, forces_reused=command.forces_reused, saturated=command.saturated)
        topics = {text.partition(":")[0]: text for text in command.warnings}  # the part after the colon varies
        self.warnings += [(t, text) for topic, text in topics.items() if topic not in self._last_warnings]
        self._last_warnings = set(topics)

    def add_results(self, plant: PlantInterface) -> None:
        """Add the torques and contacts of a step."""
        contacts = plant.true_contacts()
        self._add(
            tau=contacts.tau,
            touching=contacts.touching,
            f=contacts.f,
            p_OC=contacts.p_OC,
            R_OC=contacts.R_OC,
            mu=contacts.mu,
            gamma=contacts.gamma,
            depth=contacts.depth,
        )
