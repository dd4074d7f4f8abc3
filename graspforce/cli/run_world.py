"""The command ``graspforce simulate`` in a world: a controller that knows measurements only, judged by the truth."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np
from rich.console import Console
from rich.table import Table

from graspforce import simulation
from graspforce.cli.controllers import CONTROLLER_NAMES, FACTORIES, Assumptions, ControllerName
from graspforce.cli.interruption import Interruption
from graspforce.cli.json_output import put_result
from graspforce.cli.live_view import live_view
from graspforce.cli.reference_motion import make_reference
from graspforce.cli.run_simulation import SimulateOutput, show_heat, start_grasp, write_mcap
from graspforce.cli.simulate_options import SimulateOptions
from graspforce.cli.step_callbacks import FilmOptions, StepCallback, film_callback, progress_bar, viewer_callback
from graspforce.cli.world_options import WorldOptions
from graspforce.core import fields
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.simulation import (
    ControllerCommand,
    ExactController,
    MeasuredController,
    MeasuredRecording,
    Plant,
    PlantInterface,
    World,
)
from graspforce.simulation.campaigns.outcome import RunOutcome, judge_run
from graspforce.simulation.loops.comparison_controllers import exact_settings
from graspforce.simulation.plants.plant_options import PlantOptions
from graspforce.simulation.plants.scene import TIP_GEOMETRIES
from graspforce.simulation.plants.urdf_plant import UrdfPlant
from graspforce.simulation.worlds.world_plants import PLANT_NAMES, PlantName, make_plant, make_urdf_plant, with_drives

_MAX_WARNINGS = 5  # shown


@dataclasses.dataclass(frozen=True, slots=True)
class RunnerOptions:
    """The controller and the plant of a run in a world.

    Args:
        controller: name of the controller.
        plant: "links" or "urdf".
        assumptions: errors of its model that the controller plans for.
    """

    controller: ControllerName
    plant: PlantName = "links"
    assumptions: Assumptions = dataclasses.field(default_factory=Assumptions)


def make_runner_options(controller: str | None, plant: str | None, assume: str | None, default: Assumptions) -> RunnerOptions:
    """Return the options of texts; None for the defaults.

    Args:
        controller: name of the controller.
        plant: name of the plant.
        assume: errors that the controller plans for, as for `Assumptions.parse`.
        default: errors that it plans for if `assume` is None.

    Raises:
        InvalidInput: an unknown name.
    """
    return RunnerOptions(
        fields.check_choice(controller or CONTROLLER_NAMES[0], "--controller", CONTROLLER_NAMES),
        fields.check_choice(plant or PLANT_NAMES[0], "--plant", PLANT_NAMES),
        default if assume is None else Assumptions.parse(assume),
    )


def run(
    options: SimulateOptions, world_options: WorldOptions, runner: RunnerOptions, output: SimulateOutput, console: Console
) -> bool:
    """Find a grasp, simulate it in a world, and show the results.

    Args:
        options: the simulation.
        world_options: the world.
        runner: controller and plant.
        output: files and windows.
        console: shows progress and results.

    Returns:
        Whether the object was held, as `judge_run` judges.

    Raises:
        InvalidInput: an option is impossible, no grasp was found, or a display is missing.
    """
    has_film = output.view is not None or output.video is not None or output.frames is not None
    if runner.plant == "urdf" and (has_film or options.tips != "ball"):
        raise InvalidInput("--plant", "urdf", "links with --view, --video, --frames or --tips mesh")
    options, grasp = start_grasp(options, console)
    world = world_options.world(world_options.seed, float(grasp.hand.torque_upper.min()), options.pushes)
    console.print(world_table(world))
    plant_options = world.plant_options(grasp, options.grasp.gravity_H)
    plant = _make_plant(options, runner, grasp, plant_options, world)
    driven_plant = with_drives(plant, world, grasp)
    settings = runner.assumptions.settings(options.grasp.gravity_H, world.sensors.rate)
    controller: MeasuredController
    if runner.controller == "exact":
        controller = ExactController(grasp, plant_options, exact_settings(settings, world, grasp), driven_plant)
    else:
        controller = FACTORIES[runner.controller](grasp, settings, world.sensors)
    with ExitStack() as stack:
        callbacks: list[StepCallback] = []
        subtitle = "control with full knowledge" if runner.controller == "exact" else "control from measurements"
        film = FilmOptions(output.video, output.frames, options.duration, options.meshes, subtitle, format=output.film)
        if isinstance(plant, Plant) and film.is_wanted:
            callbacks.append(stack.enter_context(film_callback(plant, film, console)))
        if isinstance(plant, Plant) and output.view == "window":
            callbacks.append(stack.enter_context(viewer_callback(plant, options.meshes)))
        progress = stack.enter_context(progress_bar(options.duration))
        live = None
        if isinstance(plant, Plant) and output.view == "browser":
            live = stack.enter_context(live_view(plant, settings.slip_margin, options.meshes, console, has_squeeze=False))

        interruption = stack.enter_context(Interruption())

        def on_step(_: PlantInterface, command: ControllerCommand) -> bool:
            progress(plant, command)
            for callback in callbacks:
                callback(plant, command)  # type: ignore[arg-type]  # callbacks exist for a Plant only
            return not interruption.is_requested and (
                live is None or not isinstance(plant, Plant) or live.follow(plant, command)
            )

        reference = make_reference(options, grasp)
        if live is not None:
            reference = live.steered_reference(reference)
        recording = simulation.simulate_measured(driven_plant, controller, reference, options.duration, world, on_step=on_step)
    outcome = judge_run(recording)
    _show(recording, outcome, output, console, world.pushes)
    if output.record is not None:
        scene = simulation.build_scene(grasp, gravity_H=options.grasp.gravity_H)
        write_mcap(recording.truth, scene, output.record, options.meshes, console)
    record = {"hand": recording.truth.hand, "is_held": outcome.is_held, "outcome": outcome, "drop_time": recording.drop_time}
    put_result(console, {**record, **show_heat(recording.truth, grasp, console)})
    return outcome.is_held


def _make_plant(
    options: SimulateOptions, runner: RunnerOptions, grasp: Grasp, plant_options: PlantOptions, world: World
) -> Plant | UrdfPlant:
    """Return the plant of a world."""
    if runner.plant == "urdf":
        return make_urdf_plant(grasp, plant_options, pushes=world.pushes)
    tips = fields.check_choice(options.tips, "tips", TIP_GEOMETRIES)
    return make_plant(grasp, plant_options, pushes=world.pushes, tip_geometry=tips, directories=options.meshes)


def _show(
    recording: MeasuredRecording,
    outcome: RunOutcome,
    output: SimulateOutput,
    console: Console,
    pushes: Sequence[tuple[float, ...]],
) -> None:
    """Print the summary and the first warnings, and write the recording and the plots."""
    console.print(outcome_table(recording, outcome))
    for t, text in recording.truth.warnings[:_MAX_WARNINGS]:
        console.print(f"[yellow]{t:.3f} s: {text}[/]")
    if output.save is not None:
        output.save.parent.mkdir(parents=True, exist_ok=True)
        recording.save(output.save)
        console.print(f"Recording: [bold]{output.save}[/]", soft_wrap=True)
    if output.plots is not None:
        from graspforce.simulation.recordings import estimate_plots, recording_plots

        paths = [
            *recording_plots.save_plots(recording.truth, output.plots, pushes),
            *estimate_plots.save_estimate_plots(recording, output.plots),
        ]
        for path in paths:
            console.print(f"Plot: [bold]{path}[/]", soft_wrap=True)


def world_table(world: World) -> Table:
    """Return what differs between a world and what the controller is told, as a table.

    Args:
        world: the world.
    """
    table = Table("true world", "value", title=f"World of seed {world.seed}")
    rows: list[tuple[str, bool, str]] = [
        ("mass", world.mass_factor != 1.0, f"× {world.mass_factor:.3g}"),
        ("centre of mass", bool(world.centre_offset.any()), f"{1e3 * np.linalg.norm(world.centre_offset):.2g} mm off"),
        ("friction", world.friction_factor != 1.0, f"× {world.friction_factor:.3g}"),
        ("torsional friction of the pads", world.pad_torsion > 0.0, f"{1e3 * world.pad_torsion:.2g} mm"),
        ("fingertips", world.tip_offset > 0.0, f"{1e3 * world.tip_offset:.2g} mm off"),
        (
            "surface of the object",
            world.shape_offset + world.shape_turn > 0.0,
            f"{1e3 * world.shape_offset:.2g} mm and {np.degrees(world.shape_turn):.2g}° off",
        ),
        ("Coulomb friction of the joints", world.joint_friction > 0.0, f"{world.joint_friction:.3g} N·m"),
        ("motor torques", world.torque_error > 0.0, f"up to {100 * world.torque_error:.2g} % off"),
        ("stiffness of drives", world.stiffness_error > 0.0, f"up to {100 * world.stiffness_error:.2g} % off"),
        ("delay, backlash and losses of drives", world.drive_error > 0.0, f"up to {100 * world.drive_error:.2g} % off"),
        ("delay", world.sensors.latency > 0.0, f"{1e3 * world.sensors.latency:.3g} ms"),
        ("encoder noise", world.sensors.encoder_noise > 0.0, f"{1e3 * world.sensors.encoder_noise:.2g} mrad"),
        ("constant encoder error", world.encoder_offset > 0.0, f"up to {1e3 * world.encoder_offset:.2g} mrad"),
        ("push", bool(world.pushes), "\n".join(_push_text(push) for push in world.pushes)),
        ("drives off", bool(world.drive_losses), ", ".join(f"{name} from {t:g} s" for name, t in world.drive_losses)),
    ]
    for name, differs, text in rows:
        if differs:
            table.add_row(name, text)
    for name, deviation, unit in (
        ("fingertip forces", world.sensors.tip_force_noise, "N"),
        ("joint torques", world.sensors.torque_noise, "N·m"),
        ("motor currents", world.sensors.current_noise, "A"),
    ):
        table.add_row(name, "not measured" if deviation is None else f"measured with {deviation:.2g} {unit} noise")
    camera = world.sensors.camera
    if camera is None:
        table.add_row("pose of the object", "not measured")
    else:
        noise = f"{1e3 * camera.position_noise:.2g} mm and {np.degrees(camera.angle_noise):.2g}° noise"
        bias = f", {1e3 * camera.position_bias:.2g} mm bias" if camera.position_bias > 0.0 else ""
        lost = f", lost {len(world.camera_outages)} ×" if world.camera_outages else ""
        table.add_row("pose of the object", f"{camera.rate:g} Hz, {1e3 * camera.latency:.3g} ms late, {noise}{bias}{lost}")
    return table


def _push_text(push: tuple[float, ...]) -> str:
    """Return a push as text."""
    return f"{np.linalg.norm(push[:3]):.2g} N from {push[3]:.2f} s for {push[4]:.2g} s"


def outcome_table(recording: MeasuredRecording, outcome: RunOutcome) -> Table:
    """Return the outcome of a run as a table.

    Args:
        recording: the run.
        outcome: its outcome.
    """
    table = Table("metric", "value", title=f"{recording.truth.hand}, {recording.truth.t[-1] + 1e-3:.3g} s in closed loop")
    sign = "" if outcome.sign == "none" or outcome.t is None else f"; first sign: {outcome.sign} at {outcome.t:.3f} s"
    table.add_row("result", outcome.result + sign)
    if recording.drop_time is not None:
        table.add_row("dropped at", f"{recording.drop_time:.3f} s")
    if recording.controller_error:
        table.add_row("error of the controller after the drop", recording.controller_error)
    if outcome.motion_rms is not None and outcome.motion_peak is not None:
        rms, peak = 1e3 * outcome.motion_rms, 1e3 * outcome.motion_peak
        table.add_row("motion error since the start", f"{rms:.4f} mm RMS, {peak:.4f} mm peak")
    if outcome.turn_peak is not None:
        table.add_row("rotation error since the start", f"{np.degrees(outcome.turn_peak):.4f}° peak")
    if recording.estimate is not None:
        held = recording.estimate.t < (recording.drop_time or np.inf)
        error = recording.estimation_error()[held]
        position, angle = (np.sqrt(np.mean(np.sum(part**2, axis=1))) for part in (error[:, :3], error[:, 3:]))
        table.add_row("estimate less truth", f"{1e3 * position:.4f} mm and {np.degrees(angle):.4f}° RMS")
        error = recording.tracking_error()[held]
        position, angle = (np.sqrt(np.mean(np.sum(part**2, axis=1))) for part in (error[:, :3], error[:, 3:]))
        table.add_row("estimate less reference", f"{1e3 * position:.4f} mm and {np.degrees(angle):.4f}° RMS")
    if outcome.sliding is not None:
        table.add_row("largest sliding of a fingertip", f"{1e3 * outcome.sliding:.4f} mm")
    if outcome.peak_force is not None:
        table.add_row("maximum normal force", f"{outcome.peak_force:.2f} N")
    metrics = simulation.compute_metrics(recording.truth)
    table.add_row("steps with a lost contact", str(metrics.lost_contact_steps))
    table.add_row("steps without certified forces", str(metrics.reused_force_steps))
    table.add_row("camera poses received", str(len(recording.camera.t_image)))
    return table
