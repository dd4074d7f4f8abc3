"""The command ``graspforce simulate --free``: move a hand without an object, and show step responses and torques."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from graspforce.cli.console import progress_console
from graspforce.cli.interruption import Interruption
from graspforce.cli.json_output import put_result
from graspforce.cli.options import parse_vector
from graspforce.cli.output_files import check_new_folder
from graspforce.cli.run_simulation import LOCKSTEP_VALIDITY, ServiceOptions, connect_service
from graspforce.cli.stream_controller import JointStreamController
from graspforce.cli.tables import NO_VALUE
from graspforce.control.joints.joint_controller import JOINT_LAWS, JointController
from graspforce.control.joints.joint_reference import minimum_jerk_reference
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.hand.hand import Hand
from graspforce.service import JointStreamSetup
from graspforce.simulation.free_hand.free_plant import FreeHandPlant
from graspforce.simulation.free_hand.joint_run import JointRun, JointStepper, run_joints, step_responses

DEFAULT_SHARE = 0.5  # of the way from the neutral posture to the farther limit, without --posture
_PROGRESS_STEPS = 50  # steps between two updates


@dataclass(frozen=True, slots=True)
class FreeOptions:
    """The motion of a hand without an object.

    Args:
        hand: name or description file of the hand.
        law: control law.
        posture: goal, ``JOINT=RAD,…``; None for the middle between neutral and the farther limit of every joint.
        rise: time of the motion to the goal, s; 0 for a step.
        frequency: natural frequency of the controller, Hz.
        gravity: ``X,Y,Z`` in H, m/s².
        duration: simulated time, s.
        joint_friction: Coulomb friction of all joints of the plant, N·m; the controller does not know it.

    Raises:
        InvalidInput: names the option and the allowed values.
    """

    hand: str
    law: str = "computed_torque"
    posture: str | None = None
    rise: float = 0.0
    frequency: float = 3.0
    gravity: str = "0,0,-9.81"
    duration: float = 2.0
    joint_friction: float = 0.0

    def __post_init__(self) -> None:
        fields.check_choice(self.law, "--law", JOINT_LAWS)
        arrays.check_number(self.rise, "--rise", minimum=0.0)
        arrays.check_number(self.frequency, "--frequency", above=0.0)
        arrays.check_number(self.duration, "--duration", above=0.0)
        arrays.check_number(self.joint_friction, "--joint-friction", minimum=0.0)


def run(
    options: FreeOptions, save: Path | None, plots: Path | None, console: Console, service: ServiceOptions | None = None
) -> bool:
    """Simulate the motion, print the step responses, and write files.

    Args:
        options: the motion.
        save: file of the recording; None for none.
        plots: folder of the plots; None for none.
        console: shows progress and results.
        service: where the law runs, in lockstep; None for this process.

    Returns:
        Whether every joint settled.

    Raises:
        InvalidInput: an option is not allowed, or a file cannot be written.
        UnknownName: the hand has no such joint.
    """
    check_new_folder(plots, "--plots")
    hand = Hand.load(options.hand)
    gravity_H = parse_vector(options.gravity, "gravity")
    goal = _middle_posture(hand) if options.posture is None else parse_posture(options.posture, hand)
    controller = JointController.with_frequency(
        hand, fields.check_choice(options.law, "--law", JOINT_LAWS), options.frequency, gravity_H
    )
    friction = np.full(hand.n, options.joint_friction)
    plant = FreeHandPlant(hand, gravity_H=gravity_H, joint_friction=friction)
    columns = (
        TextColumn("Simulating"),
        BarColumn(),
        TextColumn("{task.completed:.2f} of {task.total:g} s"),
        TimeRemainingColumn(),
    )
    with ExitStack() as stack:
        stepper = joint_stepper(controller, plant.dt, service, console, stack)
        bar = stack.enter_context(Progress(*columns, console=progress_console()))
        task = bar.add_task("", total=options.duration)

        interruption = stack.enter_context(Interruption())

        def on_step(t: float) -> bool:
            if round(t / plant.dt) % _PROGRESS_STEPS == 0:
                bar.update(task, completed=t)
            return not interruption.is_requested

        reference = minimum_jerk_reference(hand.neutral, goal, options.rise)
        result = run_joints(plant, stepper, reference, options.duration, on_step)
        bar.update(task, completed=options.duration)
    _print_table(result, console)
    if save is not None:
        save.parent.mkdir(parents=True, exist_ok=True)
        result.save(save)
        console.print(f"Recording: [bold]{save}[/]", soft_wrap=True)
    if plots is not None:
        from graspforce.simulation.free_hand.joint_plots import save_joint_plots

        for path in save_joint_plots(result, plots):
            console.print(f"Plot: [bold]{path}[/]", soft_wrap=True)
    responses = step_responses(result)
    put_result(console, {"hand": result.hand, "law": result.law, "responses": responses})
    return not any(np.isnan(response.settling_time) for response in responses)


def joint_stepper(
    controller: JointController, period: float, service: ServiceOptions | None, console: Console, stack: ExitStack
) -> JointStepper:
    """Return the controller, in the service if there is one.

    Args:
        controller: the joint-space law.
        period: of the control, s.
        service: where the law runs, in lockstep; None for this process.
        console: shows the address of the service.
        stack: closes the stream.

    Raises:
        ServiceError: the service is missing or does not serve the hand.
    """
    if service is None:
        return controller
    client = stack.enter_context(connect_service(service, controller.hand.name, console))
    setup = JointStreamSetup(controller, period, LOCKSTEP_VALIDITY)
    return JointStreamController(stack.enter_context(client.open_joint_stream(setup)))


def parse_posture(text: str, hand: Hand) -> Array:
    """Return the posture ``JOINT=RAD,…``; other joints are neutral.

    Args:
        text: the posture.
        hand: the hand.

    Raises:
        InvalidInput: the text cannot be read, or a position is outside the joint's limits.
        UnknownName: the hand has no such joint.
    """
    q = np.array(hand.neutral)
    for part in text.split(","):
        name, separator, value = part.partition("=")
        if not separator:
            raise InvalidInput("--posture", text, "JOINT=RAD, separated by commas")
        if name not in hand.joint_names:
            raise UnknownName("--posture", name, hand.joint_names)
        j = hand.joint_names.index(name)
        try:
            q[j] = float(value)
        except ValueError:
            raise InvalidInput(f"--posture {name}", value, f"a number of {hand.joints[j].position_unit}") from None
        if not hand.q_lower[j] <= q[j] <= hand.q_upper[j]:
            allowed = f"from {hand.q_lower[j]:g} to {hand.q_upper[j]:g} {hand.joints[j].position_unit}"
            raise InvalidInput(f"--posture {name}", float(q[j]), allowed)
    return q


def _middle_posture(hand: Hand) -> Array:
    """Return the posture half-way from neutral to the farther limit of every joint, rad."""
    up, down = hand.q_upper - hand.neutral, hand.q_lower - hand.neutral
    return np.asarray(hand.neutral + DEFAULT_SHARE * np.where(up >= -down, up, down))


def _print_table(result: JointRun, console: Console) -> None:
    """Print the step responses, one joint a row."""
    table = Table(title=f"{result.hand}, {result.law}: {result.t[-1] + result.t[1]:.3g} s without an object")
    for column in ("joint", "travel", "settled", "overshoot", "error", "torque", "of limit"):
        table.add_column(column, justify="left" if column == "joint" else "right", no_wrap=column == "joint")
    units = dict(zip(result.joints, result.units, strict=True))
    for each in step_responses(result):
        slides = units[each.joint] == "m"
        factor, unit, torque = (1e3, " mm", "N") if slides else (float(np.degrees(1.0)), "°", "N·m")
        table.add_row(
            each.joint,
            f"{factor * each.travel:.1f}{unit}",
            NO_VALUE if np.isnan(each.settling_time) else f"{each.settling_time:.3f} s",
            f"{100.0 * each.overshoot:.1f} %",
            f"{abs(factor * each.final_error):.3f}{unit}",
            f"{each.peak_torque:.3f} {torque}",
            f"{100.0 * each.peak_use:.0f} %",
        )
    console.print(table)
