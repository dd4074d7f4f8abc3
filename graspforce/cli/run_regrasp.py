"""The command ``graspforce regrasp``: plan finger steps that turn a held object, execute them, and show the result."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from graspforce.cli.interruption import Interruption
from graspforce.cli.json_output import put_result
from graspforce.cli.options import GraspOptions, RunFiles
from graspforce.control import Command, ControlSettings
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry.rotations import rotation_exp
from graspforce.grasp.grasp import Grasp
from graspforce.planning.failure import PlanFailure
from graspforce.planning.regrasp import (
    PosePath,
    RegraspController,
    RegraspPlan,
    RegraspProgress,
    RegraspSettings,
    RegraspTask,
    StartOptions,
    find_regrasp_start,
    goal_from_steps,
    plan_regrasp,
    plan_regrasp_to,
)
from graspforce.simulation import Plant, build_scene
from graspforce.simulation.loops.regrasp_loop import simulate_regrasp
from graspforce.simulation.plants.plant_interface import PlantInterface
from graspforce.simulation.recordings.regrasp_run import RegraspRun

_PROGRESS_STEPS = 50  # control steps between two updates
_ELEVATION = math.radians(40.0)  # of the film's camera: it sees the fingers around the object
_VIEW = 2.5  # radius that the film shows, over that of the object


@dataclass(frozen=True, slots=True)
class RegraspOptions:
    """The turn that the command's options describe.

    Args:
        grasp: hand, object and seed.
        axis_H: (3,) axis of the turn in H, of any length but zero.
        angle: of the turn, rad.
        object_axis_H: (3,) direction of the object's z axis in H at the start, of any length but zero.
        slip_margin: that the forces keep, N.
        budget: of the search, s.
        to: (3,) translation to a goal pose in H, m, in place of the turn about an axis; None for that turn.
        turn: (3,) rotation vector to the goal pose in H, rad.
        friction_error: part of the friction by which it may be less than stated.

    Raises:
        InvalidInput: names the option and the allowed values.
    """

    grasp: GraspOptions
    axis_H: tuple[float, ...]
    angle: float
    object_axis_H: tuple[float, ...]
    slip_margin: float
    budget: float
    to: tuple[float, ...] | None = None
    turn: tuple[float, ...] = (0.0, 0.0, 0.0)
    friction_error: float = 0.0

    def __post_init__(self) -> None:
        for name, axis in (("--axis", self.axis_H), ("--object-axis", self.object_axis_H)):
            if not any(arrays.check_array(axis, name, (3,))):
                raise InvalidInput(name, axis, "a direction: not zero")
        if arrays.check_number(self.angle, "--angle") == 0.0:
            raise InvalidInput("--angle", self.angle, "an angle other than zero, rad")
        arrays.check_number(self.slip_margin, "--slip-margin", minimum=0.0)
        arrays.check_number(self.budget, "--budget", above=0.0)
        if arrays.check_number(self.friction_error, "--friction-uncertainty", minimum=0.0) >= 1.0:
            raise InvalidInput("--friction-uncertainty", self.friction_error, "less than 1")
        if self.to is not None and not any(self.to + self.turn):
            raise InvalidInput("--to", self.to, "different from zero, or give --turn")

    @property
    def control(self) -> ControlSettings:
        """Settings of the controller."""
        gravity_H, error = self.grasp.gravity_H, self.friction_error
        return ControlSettings(slip_margin=self.slip_margin, gravity_H=gravity_H, friction_error=error)

    @property
    def orientation(self) -> Array:
        """(3, 3) axes of the object in H at the start."""
        x, y, z = np.array(self.object_axis_H) / np.linalg.norm(self.object_axis_H)
        horizontal = math.hypot(x, y)
        turn = math.atan2(horizontal, z)  # rad, about the axis orthogonal to both directions
        about = np.array([1.0, 0.0, 0.0]) if horizontal == 0.0 else np.array([-y, x, 0.0]) / horizontal
        return rotation_exp(turn * about)


def run(options: RegraspOptions, output: RunFiles, console: Console) -> bool:
    """Plan the turn, execute it in simulation, and show the results.

    Args:
        options: the turn.
        output: files.
        console: shows progress and results.

    Returns:
        Whether a plan was found and the object reached its goal.

    Raises:
        InvalidInput: the fingers have no grasp from which each can step.
    """
    grasp = _start(options, console)
    plan = _plan(options, grasp, console)
    if isinstance(plan, PlanFailure):
        console.print(f"[bold red]No plan.[/] {plan.reason}")
        put_result(console, {"hand": grasp.hand.name, "is_complete": False, "reason": plan.reason})
        return False
    console.print(str(plan), highlight=False)
    result = _simulate(plan, output, console)
    _show(plan, result, output, console)
    put_result(console, _record(plan, result))
    return result.is_complete


def _start(options: RegraspOptions, console: Console) -> Grasp:
    """Search a grasp from which each finger can step, and print it."""
    given = options.grasp
    fingers = None if given.fingers is None else given.fingers.split(",")
    start = StartOptions(
        fingers=fingers, friction=given.mu, R_HO=options.orientation, control=options.control, seed=given.seed
    )  # fmt: skip
    with console.status(f"Searching a grasp of the {given.object_name} from which each finger of {given.hand.name} can step"):
        grasp = find_regrasp_start(given.hand, given.body, start)
    console.print(f"[bold]{given.hand.name}[/] holds the [bold]{given.object_name}[/] with {', '.join(grasp.fingers)}.")
    return grasp


def _plan(options: RegraspOptions, grasp: Grasp, console: Console) -> RegraspPlan | PlanFailure:
    """Plan object moves and finger steps with a progress bar."""
    settings = RegraspSettings(budget=options.budget, seed=options.grasp.seed)
    with _progress(console) as bar:
        task = bar.add_task("Planning finger steps", total=1.0)

        def on_progress(progress: RegraspProgress) -> None:
            share = progress.u / progress.length
            description = f"Planning finger steps: {100.0 * share:.0f} % of the path, {progress.tried} steps tried"
            bar.update(task, completed=share, description=description)

        if options.to is not None:
            return plan_regrasp_to(goal_from_steps(grasp, options.to, options.turn, options.control), settings, on_progress)
        axis = np.array(options.axis_H) / np.linalg.norm(options.axis_H)
        path = PosePath.turn(grasp.p_HO, grasp.R_HO, axis, options.angle)
        return plan_regrasp(RegraspTask(grasp, path, options.control), settings, on_progress)


def _simulate(plan: RegraspPlan, output: RunFiles, console: Console) -> RegraspRun:
    """Execute the plan on a plant with progress and film."""
    from graspforce.cli.phase_film import PhaseFilm  # imported here: drawing is slow to import
    from graspforce.simulation.rendering import CameraOptions

    grasp, control = plan.task.grasp, plan.task.control
    plant, controller = Plant(build_scene(grasp, gravity_H=control.gravity_H)), RegraspController(plan)
    film = None
    if output.video or output.frames:
        size = float(np.linalg.norm(grasp.contacts.p_OC, axis=1).max())  # m, from the middle of the object
        view = CameraOptions(elevation=_ELEVATION, radius=_VIEW * size)
        film = PhaseFilm("finger steps, forces certified", output, console, view)
    with ExitStack() as stack:
        bar = stack.enter_context(_progress(console))
        task = bar.add_task("Executing", total=len(plan.stages))

        interruption = stack.enter_context(Interruption())

        def on_step(_: PlantInterface, __: Command) -> bool:
            finger = controller.moving_finger
            status = f"{finger}: {controller.phase.value}" if finger else "all fingers move"
            if round(plant.t / plant.dt) % _PROGRESS_STEPS == 0:
                bar.update(task, completed=controller.stage, description=f"Executing: {plant.t:5.1f} s, {status}")
            if film is not None:
                film.add(plant, status)
            return not interruption.is_requested

        result = simulate_regrasp(plant, controller, plan, on_step)
    if film is not None:
        film.render()
    return result


def _progress(console: Console) -> Progress:
    """Return a progress bar that disappears at its end."""
    return Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=console, transient=True)


def _show(plan: RegraspPlan, result: RegraspRun, output: RunFiles, console: Console) -> None:
    """Print the outcome, and write the plots."""
    console.print(outcome_table(plan, result))
    if output.plots is not None:
        from graspforce.simulation.recordings.regrasp_plots import save_regrasp_plots

        for path in save_regrasp_plots(result, plan.task.grasp.hand, output.plots):
            console.print(f"Plot: [bold]{path}[/]", soft_wrap=True)


def _record(plan: RegraspPlan, result: RegraspRun) -> dict[str, object]:
    """Return the outcome of a run for JSON."""
    return {
        "hand": plan.task.grasp.hand.name,
        "is_complete": result.is_complete,
        "steps": plan.step_count,
        "duration": result.t[-1],
        "final_error": result.final_error,
        "least_planned_margin": result.planned_margin.min(),
        "uncertified_periods": result.uncertified_count,
        "largest_torque_step": result.largest_torque_step,
        "collisions": result.collisions,
    }


def outcome_table(plan: RegraspPlan, result: RegraspRun) -> Table:
    """Return the outcome of a run as a table.

    Args:
        plan: the plan.
        result: its execution.
    """
    table = Table("metric", "value", title=f"{plan.task.grasp.hand.name}, {result.t[-1]:.3g} s, judged by the truth")
    table.add_row("result", "complete" if result.is_complete else f"ended in {result.outcome.value}")
    table.add_row("finger steps", str(plan.step_count))
    distance, angle = (float(np.linalg.norm(result.final_error[rows])) for rows in (slice(3), slice(3, 6)))
    table.add_row("distance from the goal", f"{1e3 * distance:.3f} mm and {math.degrees(angle):.3f}°")
    table.add_row("largest distance from the path", f"{1e3 * np.linalg.norm(result.error[:, :3], axis=1).max():.3f} mm")
    table.add_row("least planned slip margin", f"{result.planned_margin.min():.3f} N")
    table.add_row("periods without certified forces", f"{result.uncertified_count} of {len(result.t)}")
    table.add_row("largest change of a torque in a period", f"{result.largest_torque_step:.3f} N·m")
    touched = ", ".join(f"{first} and {second}" for first, second in result.collisions)
    table.add_row("bodies that touched and should not", touched or "none")
    return table
