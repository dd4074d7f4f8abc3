"""The command ``graspforce cycle``: find a grasp over a table, simulate all phases, and show what became of them."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn
from rich.table import Table

from graspforce.cli.controllers import REAL_ASSUMPTIONS, Assumptions
from graspforce.cli.interruption import Interruption
from graspforce.cli.json_output import put_result
from graspforce.cli.options import GraspOptions, RunFiles
from graspforce.cli.run_simulation import ServiceOptions, connect_service
from graspforce.cli.run_world import world_table
from graspforce.cli.stream_controller import PhaseStreamController
from graspforce.control.phases.cycle_plan import CyclePlan
from graspforce.control.phases.motion_profile import CarryProfiles
from graspforce.control.phases.phase_controller import PhaseController
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.phase_step import PhaseCommand
from graspforce.control.settings import ControlSettings
from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.estimation.sensor_model import SensorModel
from graspforce.hand.hand import GRAVITY_PALM_UP
from graspforce.planning.failure import PlanFailure
from graspforce.planning.fastest_cycle import CycleLimits, fastest_cycle
from graspforce.service import PhaseStreamSetup
from graspforce.simulation.cycle.cycle_outcome import CycleOutcome, judge_cycle, phase_table
from graspforce.simulation.cycle.cycle_run import CycleRecording
from graspforce.simulation.cycle.episode import ControllerMaker, PoseError, run_episode
from graspforce.simulation.cycle.plan_cycle import CycleMotion, find_cycle
from graspforce.simulation.cycle.table_scene import TableScene
from graspforce.simulation.plants.plant import Plant
from graspforce.simulation.worlds.world import World

_LIMIT_OPTIONS = {
    "speed": "base-speed", "acceleration": "base-acceleration", "jerk": "base-jerk", "joint_jerk": "joint-jerk",
    "torque_reserve": "reserve",
}  # fmt: skip
WORLDS = ("nominal", "real")
CONTROLLERS = ("estimate", "exact")
_LOCKSTEP_VALIDITY = 2.0  # s: the plant waits for each command, and a late one stops the cycle
_PROGRESS_STEPS = 50  # steps between two updates


@dataclass(frozen=True, slots=True)
class CycleOptions:
    """The cycle that the command's options describe.

    Args:
        grasp: hand, object and grasp search.
        lift: height of the lift, m.
        move: displacement along the table, m.
        pose_error: largest errors of the object's expected place, m, and rotation, rad.
        world: nominal or real.
        world_seed: of the world and of the pose error.
        controller: estimate or exact.
        standoff: distance of the fingertips from the contacts before the close, m.
        touch_force: largest force of a fingertip before the squeeze, N.
        limits: limits of the fastest motions; None for fixed times.

    Raises:
        InvalidInput: names the option and the allowed values.
    """

    grasp: GraspOptions
    lift: float
    move: tuple[float, ...]
    pose_error: tuple[float, float]
    world: str
    world_seed: int
    controller: str
    standoff: float
    touch_force: float
    limits: CycleLimits | None = None

    def __post_init__(self) -> None:
        arrays.check_number(self.lift, "--lift", above=0.0)
        for value in self.pose_error:
            arrays.check_number(value, "--pose-error", minimum=0.0)
        fields.check_choice(self.world, "--world", WORLDS)
        fields.check_choice(self.controller, "--controller", CONTROLLERS)
        try:
            self.settings()
        except InvalidInput as error:
            raise error.with_field(f"--{error.field.replace('_', '-')}") from None

    def settings(self) -> PhaseSettings:
        """Return the settings of the phases."""
        return PhaseSettings(standoff=self.standoff, touch_force=self.touch_force)

    @property
    def assumptions(self) -> Assumptions:
        """Errors that the controller assumes."""
        return REAL_ASSUMPTIONS if self.world == "real" else Assumptions()


def parse_cycle_limits(speed: float, acceleration: float, jerk: float, joint_jerk: float, reserve: float) -> CycleLimits:
    """Return the limits of the fastest motions from the command's options.

    Args:
        speed: --base-speed, m/s.
        acceleration: --base-acceleration, m/s².
        jerk: --base-jerk, m/s³.
        joint_jerk: --joint-jerk, rad/s³.
        reserve: --reserve, a fraction of the torques.

    Raises:
        InvalidInput: a value out of range; names the option.
    """
    try:
        return CycleLimits(speed, acceleration, jerk, joint_jerk, reserve)
    except InvalidInput as error:
        raise error.with_field(f"--{_LIMIT_OPTIONS.get(error.field, error.field)}") from None


def run(options: CycleOptions, output: RunFiles, console: Console, service: ServiceOptions | None = None) -> bool:
    """Find a grasp of an object on a table, simulate the cycle, and show the results.

    Args:
        options: the cycle.
        output: files.
        console: shows progress and results.
        service: where the controller runs, in lockstep; None for this process.

    Returns:
        Whether the object was lifted, moved, placed and released, by the true motion.

    Raises:
        InvalidInput: an option is impossible, or no grasp allows a cycle.
    """
    if service is not None and options.controller == "exact":
        raise InvalidInput("--controller", "exact", "estimate with a service, which has the hand of its description")
    scene, plan = _find(options, console)
    torque_limit = float(scene.grasp.hand.torque_upper.min())
    world = World.real(options.world_seed, torque_limit) if options.world == "real" else World(seed=options.world_seed)
    if options.world == "real":
        console.print(world_table(world))
    if options.limits is not None:
        plan = _fastest(plan, options, world, console)
    with ExitStack() as stack:
        make_controller = _controller_maker(service, scene.grasp.hand.name, console, stack)
        recording = _simulate(options, output, console, (scene, plan, world), make_controller)
    outcome = judge_cycle(recording)
    _show(recording, outcome, output, console)
    put_result(console, {"hand": scene.grasp.hand.name, "is_success": outcome.is_success, "outcome": outcome})
    return outcome.is_success


def _find(options: CycleOptions, console: Console) -> tuple[TableScene, CyclePlan]:
    """Search a grasp and plan its cycle, and print them."""
    given = options.grasp
    fingers = None if given.fingers is None else given.fingers.split(",")
    with console.status(f"Searching a grasp of the {given.object_name} on a table with {given.hand.name}") as status:

        def on_seed(seed: int, fault: str) -> None:
            if fault:
                status.update(f"Searching: the grasp of seed {seed} is not good enough")

        motion = CycleMotion(options.lift, (options.move[0], options.move[1]))
        scene, plan = find_cycle(
            given.hand, given.body, fingers, friction=given.mu, seed=given.seed, settings=options.settings(), motion=motion,
            control=options.assumptions.settings(GRAVITY_PALM_UP), on_seed=on_seed,
        )  # fmt: skip
    standoff = ", ".join(f"{1e3 * each:.0f}" for each in plan.standoff)
    console.print(
        f"[bold]{given.hand.name}[/] takes the [bold]{given.object_name}[/] with {', '.join(scene.grasp.fingers)}; "
        f"{1e3 * scene.clearance:.0f} mm above the table, stand-off {standoff} mm."
    )
    return scene, plan


def _fastest(plan: CyclePlan, options: CycleOptions, world: World, console: Console) -> CyclePlan:
    """Return the plan with the fastest motions, and print their times."""
    control = options.assumptions.settings(plan.gravity_H, world.sensors.rate)
    with console.status("Planning the fastest motions"):
        fast = fastest_cycle(plan, control, options.limits)
    if isinstance(fast, PlanFailure):
        raise InvalidInput("--minimum-time", fast.reason, "a cycle that the limits allow")
    times = [("approach", plan.approach.duration, fast.approach.duration)]
    profiles = zip(plan.carry_profiles, fast.carry_profiles, strict=True)
    names = zip(CarryProfiles._fields, profiles, strict=True)
    times += [(name, before.duration, after.duration) for name, (before, after) in names]
    words = ", ".join(f"{name} {after:.3f} s ({before:.3f})" for name, before, after in times)
    console.print(f"Fastest motions, with fixed times in brackets: {words}.")
    return fast


def _controller_maker(service: ServiceOptions | None, hand: str, console: Console, stack: ExitStack) -> ControllerMaker:
    """Return the maker of the controller, which runs in the service if there is one."""
    if service is None:
        return PhaseController
    client = stack.enter_context(connect_service(service, hand, console))

    def make(
        plan: CyclePlan, phases: PhaseSettings | None, sensors: SensorModel, settings: ControlSettings
    ) -> PhaseStreamController:
        setup = PhaseStreamSetup(plan, phases or PhaseSettings(), sensors, settings, _LOCKSTEP_VALIDITY)
        return PhaseStreamController(stack.enter_context(client.open_phase_stream(setup)))

    return make


def _simulate(
    options: CycleOptions,
    output: RunFiles,
    console: Console,
    setting: tuple[TableScene, CyclePlan, World],
    make_controller: ControllerMaker,
) -> CycleRecording:
    """Simulate the cycle with progress and film."""
    from graspforce.cli.phase_film import PhaseFilm  # imported here: drawing is slow to import

    scene, plan, world = setting
    control = options.assumptions.settings(scene.gravity_H, world.sensors.rate)
    with ExitStack() as stack:
        bar = stack.enter_context(Progress(SpinnerColumn(), TextColumn("{task.description}"), console=console, transient=True))
        task = bar.add_task("approach")
        film = None
        if output.video or output.frames:
            film = PhaseFilm("a grasp cycle, from measurements", output, console)

        interruption = stack.enter_context(Interruption())

        def on_step(plant: Plant, command: PhaseCommand) -> bool:
            if round(plant.t / plant.dt) % _PROGRESS_STEPS == 0:
                bar.update(task, description=f"{plant.t:5.2f} s: {command.phase}")
            if film is not None:
                film.add(plant, command.phase)
            return not interruption.is_requested

        recording = run_episode(
            scene, plan, world, PoseError(*options.pose_error), control, options.settings(),
            knows_everything=options.controller == "exact", make_controller=make_controller, on_step=on_step,
        )  # fmt: skip
    if film is not None:
        film.render()
    return recording


def _show(recording: CycleRecording, outcome: CycleOutcome, output: RunFiles, console: Console) -> None:
    """Print the phases and the outcome, and write the plots."""
    phases = phase_table(recording)
    table = Table(*phases.header, title=phases.title)
    for row in phases.rows:
        table.add_row(*row)
    console.print(table)
    console.print(outcome_table(recording, outcome))
    if output.plots is not None:
        from graspforce.simulation.cycle.cycle_plots import save_cycle_plots

        for path in save_cycle_plots(recording, output.plots):
            console.print(f"Plot: [bold]{path}[/]", soft_wrap=True)


def outcome_table(recording: CycleRecording, outcome: CycleOutcome) -> Table:
    """Return the outcome of a cycle as a table.

    Args:
        recording: the cycle.
        outcome: its outcome.
    """
    hand = recording.scene.grasp.hand.name
    table = Table("metric", "value", title=f"{hand}, {recording.t[-1] + 1e-3:.3g} s, judged by the truth")
    table.add_row("result", outcome.status + (f": {outcome.message}" if outcome.message else ""))
    if not math.isnan(outcome.moved_before_squeeze):
        moved, turned = 1e3 * outcome.moved_before_squeeze, np.degrees(outcome.turned_before_squeeze)
        table.add_row("object moved before the squeeze", f"{moved:.2f} mm and {turned:.1f}°")
    if outcome.peak_planned > 0.0:
        peak = f"{outcome.peak_force:.2f} N, {outcome.peak_ratio:.2f} of the planned {outcome.peak_planned:.2f} N"
        table.add_row("largest normal force", peak)
    if not math.isnan(outcome.least_margin):
        table.add_row("least true slip margin while carried", f"{outcome.least_margin:.3f} N")
    table.add_row("height of the lift", f"{1e3 * outcome.lift_height:.1f} mm")
    tilt = "" if math.isnan(outcome.tilt) else f", tilt {np.degrees(outcome.tilt):.1f}°"
    table.add_row("distance from the goal", f"{1e3 * outcome.place_error:.1f} mm{tilt}")
    return table
