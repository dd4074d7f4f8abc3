"""The execution of a plan in MuJoCo: summary, plots and a film."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np
from rich.console import Console

from graspforce import simulation
from graspforce.cli.interruption import Interruption
from graspforce.cli.options import RunFiles
from graspforce.cli.run_simulation import summary_table
from graspforce.cli.step_callbacks import FilmOptions, StepCallback, film_callback, progress_bar
from graspforce.control import ControlSettings, ObjectController
from graspforce.grasp.grasp import Grasp
from graspforce.planning.tracking import TimeScaledPlan

_POSITION_TOLERANCE, _ORIENTATION_TOLERANCE = 1e-3, np.radians(1.0)  # m, rad: the move arrived
_GOAL_TIME = 0.1  # s: simulated time after the move
_FILM_TIME = 4.0  # s: shorter executions are shown in slow motion


def execute(pace: TimeScaledPlan, grasp: Grasp, settings: ControlSettings, output: RunFiles, console: Console) -> bool:
    """Execute a plan in MuJoCo, print its summary and the final pose error, and write the files.

    Args:
        pace: the plan, as slow as the controller can track it.
        grasp: its grasp.
        settings: settings of the controller.
        output: files to write.
        console: shows progress and results.

    Returns:
        Whether all contacts held without slip and the object arrived within 1 mm and 1°.
    """
    plant = simulation.Plant(simulation.build_scene(grasp, gravity_H=settings.gravity_H))
    duration = pace.duration + _GOAL_TIME
    with ExitStack() as stack:
        film, callbacks = _film(output, duration), list[StepCallback]()
        if film.is_wanted:
            callbacks.append(stack.enter_context(film_callback(plant, film, console)))
        callbacks.append(stack.enter_context(progress_bar(duration)))

        interruption = stack.enter_context(Interruption())

        def on_step(_: simulation.PlantInterface, command: simulation.ControllerCommand) -> bool:
            for callback in callbacks:
                callback(plant, command)
            return not interruption.is_requested

        recording = simulation.simulate(plant, ObjectController(grasp, settings), pace.reference(), duration, on_step=on_step)
    console.print(summary_table(recording))
    if output.plots is not None:
        from graspforce.simulation.recordings import recording_plots

        for file in recording_plots.save_plots(recording, output.plots / "executed"):
            console.print(f"Plot: [bold]{file}[/]", soft_wrap=True)
    metrics = simulation.compute_metrics(recording)
    off = float(np.linalg.norm(recording.position_error[-1]))
    turned = float(np.linalg.norm(recording.orientation_error[-1]))
    console.print(f"Final error: {1e3 * off:.4f} mm, {np.degrees(turned):.4f}°.")
    kept = metrics.lost_contact_steps == 0 and metrics.slip_steps == 0
    if not kept:
        console.print(
            f"[yellow]Slip: contact lost in {metrics.lost_contact_steps} steps, sliding in {metrics.slip_steps} steps.[/]"
        )
    return kept and off <= _POSITION_TOLERANCE and turned <= _ORIENTATION_TOLERANCE


def _film(output: RunFiles, duration: float) -> FilmOptions:
    """Return the film of an execution, in slow motion if it is shorter than `_FILM_TIME`."""
    slow_motion = max(1, round(_FILM_TIME / duration))
    subtitle = "minimum-time move" + (f", {slow_motion} × slower" if slow_motion > 1 else "")
    return FilmOptions(output.video, output.frames, duration, subtitle=subtitle, slow_motion=slow_motion, format=output.film)
