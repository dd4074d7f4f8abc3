"""The closed loop of a regrasp plan: object moves and finger steps on a plant."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from graspforce.contact import friction
from graspforce.contact.motion import BodyMotion
from graspforce.control.command import Command
from graspforce.control.pose_error import pose_error
from graspforce.core.arrays import Array, freeze
from graspforce.planning.regrasp import RegraspController, RegraspPhase, RegraspPlan
from graspforce.simulation.plants.plant_interface import PlantInterface
from graspforce.simulation.recordings.regrasp_run import RegraspRun

_DROP_DISTANCE = 0.03  # m: an object farther from its desired place is dropped
_OVERTIME = 3.0  # of the planned duration: forces rise and fall in addition
_ADDED_TIME = 10.0  # s


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
