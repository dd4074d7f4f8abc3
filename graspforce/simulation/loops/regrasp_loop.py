"""The closed loop of a regrasp plan: object moves and finger steps on a plant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from graspforce.contact import friction
from graspforce.contact.motion import BodyMotion
from graspforce.control.command import Command
from graspforce.control.pose_error import pose_error
from graspforce.core.arrays import Array, freeze
from graspforce.planning.regrasp import RegraspController, RegraspPhase, RegraspPlan
from graspforce.simulation.plants.plant_interface import PlantInterface

_DROP_DISTANCE = 0.03  # m: an object farther from its desired place is dropped
_OVERTIME = 3.0  # of the planned duration: forces rise and fall in addition
_ADDED_TIME = 10.0  # s


@dataclass(frozen=True, eq=False, slots=True)
class RegraspRun:
    """The recording of a run.

    Attributes:
        t: (M,) times of the steps, s.
        phase: (M,) phase of each step.
        error: (M, 6) desired minus true pose of the object in H, m and rad.
        planned_margin: (M,) least slip margin of the planned forces among contacts that do not let go or join, N.
        true_margin: (M,) least slip margin of the plant's touching contacts, N; infinite without contact.
        is_certified: (M,) whether the forces of the step have a certificate.
        tau: (M, n) motor torques, N·m.
        final_error: (6,) goal minus true pose of the object at the end, m and rad.
        outcome: phase at the end; a dropped object has another one than DONE.
        collisions: names of two bodies that touched and should not; empty if there were none.
    """

    t: Array
    phase: tuple[RegraspPhase, ...]
    error: Array
    planned_margin: Array
    true_margin: Array
    is_certified: Array
    tau: Array
    final_error: Array
    outcome: RegraspPhase
    collisions: tuple[tuple[str, str], ...]

    @property
    def is_complete(self) -> bool:
        """Whether the plan was executed to its end."""
        return self.outcome is RegraspPhase.DONE

    @property
    def largest_torque_step(self) -> float:
        """Largest change of a motor torque from one step to the next, N·m."""
        return float(np.abs(np.diff(self.tau, axis=0)).max())


def simulate_regrasp(
    plant: PlantInterface,
    controller: RegraspController,
    plan: RegraspPlan,
    on_step: Callable[[PlantInterface, Command], bool | None] | None = None,
) -> RegraspRun:
    """Execute a plan on a plant, from the plant's grasp to the end of the plan, or until the object is dropped.

    Args:
        plant: a plant of the grasp at the start; it is reset.
        controller: controller of the plan; it is reset.
        plan: the plan.
        on_step: called after each step; if it returns False, the run ends.
    """
    first = controller.step(plant.reset())
    controller.reset()
    state = plant.reset(None if first.forces_reused else first.f)
    rows: list[tuple[float, RegraspPhase, Array, float, float, bool, Array]] = []
    collisions = set[tuple[str, str]]()
    largest = _OVERTIME * plan.duration + _ADDED_TIME  # s
    while not controller.is_over and plant.t < largest:
        t, command = plant.t, controller.step(state)
        desired = controller.desired().object
        error = pose_error(desired, state.object)
        planned = _planned_margin(command, controller)
        state = plant.step(command.tau)
        contacts = plant.true_contacts()
        margins = friction.slip_margin(contacts.f, contacts.mu, contacts.gamma)[contacts.touching]
        true_margin = float(margins.min()) if len(margins) else np.inf
        collisions |= {(each.first, each.second) for each in contacts.collisions}
        rows.append((t, controller.phase, error, planned, true_margin, not command.forces_reused, command.tau))
        if on_step is not None and on_step(plant, command) is False:
            break
        if np.linalg.norm(error[:3]) > _DROP_DISTANCE:
            break
    columns = list(zip(*rows, strict=True))
    return RegraspRun(
        t=freeze(columns[0]),
        phase=columns[1],
        error=freeze(columns[2]),
        planned_margin=freeze(columns[3]),
        true_margin=freeze(columns[4]),
        is_certified=np.array(columns[5]),
        tau=freeze(columns[6]),
        final_error=freeze(pose_error(_goal(plan), state.object)),
        outcome=controller.phase,
        collisions=tuple(sorted(collisions)),
    )


def _planned_margin(command: Command, controller: RegraspController) -> float:
    """Return the least planned slip margin of the contacts whose forces are not ramped, N."""
    margins, fingers = command.slip_margin.tolist(), controller.command_fingers
    steady = [margin for margin, name in zip(margins, fingers, strict=True) if name != controller.moving_finger]
    return min(steady, default=np.inf)


def _goal(plan: RegraspPlan) -> BodyMotion:
    """Return the pose at the end of the path."""
    return plan.task.path.motion(plan.task.path.length)
