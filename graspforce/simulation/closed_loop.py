"""The closed loop: sense, command, act, a thousand times a second, and write down everything."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.contact.motion import BodyMotion
from graspforce.control.state import DesiredMotion, GraspState, object_motion
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.simulation.plant import Plant
from graspforce.simulation.recording import Recording
from graspforce.simulation.reference import Reference
from graspforce.simulation.sensors import SensorReader, Sensors


class ControllerCommand(Protocol):
    """What the loop needs of a command: `graspforce.control.Command`, or one that came over the wire. Fields as there."""

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
    """What is in the loop: `graspforce.control.ObjectController`, or anything with its step."""

    def step(self, state: GraspState, desired: DesiredMotion, external: Any = None) -> ControllerCommand:
        """The command for a measured state and a desired motion."""
        ...  # pragma: no cover


def simulate(
    plant: Plant,
    controller: Controller,
    reference: Reference,
    duration: float,
    *,
    initial_forces: Any = None,
    sensors: Sensors | None = None,
    on_step: Callable[[Plant, ControllerCommand], None] | None = None,
) -> Recording:
    """Close the loop for a while, beginning at the plant's hold with contacts that already bear the first forces.

    Args:
        plant: the hand, the object and what happens to them; it is reset.
        controller: measured state and desired motion to command. One with a memory should be new.
        reference: time in s to the desired motion.
        duration: s.
        begin: (k,) the contact forces when time begins, N and N·m. By default what the controller plans: it is asked once, at
            rest, and then reset if it has a ``reset``, since tips that press harder stand elsewhere.
        sensors: how well the state is measured; perfectly by default.
        on_step: called after every step: for progress, pictures and views. What it raises ends the run.

    Returns:
        Everything, at every step.

    Raises:
        InvalidInput: a duration of no step.
    """
    grasp = plant.scene.grasp
    steps = round(arrays.check_number(duration, "duration", above=0.0) / plant.dt)
    if steps < 1:
        raise InvalidInput("duration", duration, f"as long as a step at least, {plant.dt:g} s")
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
    """The arrays of a recording while they grow."""

    def __init__(self) -> None:
        self.values: dict[str, list[Any]] = {}
        self.warnings: list[tuple[float, str]] = []
        self._last_warnings: set[str] = set()

    def _add(self, **row: Any) -> None:
        for name, value in row.items():
            self.values.setdefault(name, []).append(value)

    def add_inputs(self, t: float, state: GraspState, desired: BodyMotion, command: ControllerCommand) -> None:
        """What the controller saw and wanted."""
        now = state.object
        self._add(t=t, q=state.q, v=state.v, p_HO=now.p_HO, R_HO=now.R_HO, twist=now.twist)
        self._add(p_desired=desired.p_HO, R_desired=desired.R_HO, twist_desired=desired.twist)
        planned: Array = command.contacts.pad(np.asarray(command.f))
        self._add(tau_command=command.tau, planned=planned, planned_R_OC=command.contacts.R_OC)
        self._add(planned_margin=command.slip_margin, forces_reused=command.forces_reused, saturated=command.saturated)
        about = {text.partition(":")[0]: text for text in command.warnings}  # what follows the colon changes every step
        self.warnings += [(t, text) for what, text in about.items() if what not in self._last_warnings]
        self._last_warnings = set(about)

    def add_results(self, plant: Plant) -> None:
        """What the plant did with it."""
        true_contacts = plant.true_contacts()
        self._add(
            tau=true_contacts.tau,
            touching=true_contacts.touching,
            f=true_contacts.f,
            p_OC=true_contacts.p_OC,
            R_OC=true_contacts.R_OC,
        )
        self._add(mu=true_contacts.mu, gamma=true_contacts.gamma, depth=true_contacts.depth)
