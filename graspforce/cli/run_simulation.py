"""The command ``graspforce simulate``: a hand holds an object in MuJoCo and moves it, under the controller, in closed loop.

It finds a hold, builds the plant, runs, and shows a summary; pictures, films, plots and the recording go where they are asked.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from graspforce import simulation
from graspforce.cli.options import GraspOptions, check_new_file, check_new_folder
from graspforce.cli.stream_controller import StreamController
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput, ModelError
from graspforce.grasp.grasp import Grasp
from graspforce.service import DEFAULT_VALIDITY, Client, start_server_process
from graspforce.simulation import ControllerCommand, Plant, Recording, Reference, Scene
from graspforce.simulation.scene import TIP_GEOMETRIES

StepCallback = Callable[[Plant, ControllerCommand], None]

PACES = ("lockstep", "real")
REFERENCES = ("still", "reach", "sine", "turn")
_FRAME_RATE = 30  # a second
_LOCKSTEP_VALIDITY = 0.2  # s: in lockstep the plant stands still while it waits, so that a command is as good as new
_SERVICE_TIMEOUT = 5.0  # s: a service that has just begun imports and compiles before its first answer


@dataclass(frozen=True, slots=True)
class SimulateOptions:
    """What to simulate; as the command's options say it.

    Args:
        hold: where the motion begins.
        reference: still, reach, sine or turn.
        travel: how far, in H: m, and for a turn the rotation vector, rad.
        period: s.
        duration: s.
        pushes: force x, y, z in H, N, start and duration, s.
        tips: of the plant: "ball", as the controller has them, or "mesh", as the hand's model does.
        meshes: directories in which the meshes of the hand's model are looked for.

    Raises:
        InvalidInput: another reference or other tips, a turn by no angle, or no time.
    """

    grasp: GraspOptions
    reference: str
    travel: tuple[float, ...]
    period: float
    duration: float
    pushes: tuple[tuple[float, ...], ...]
    tips: str = "ball"
    meshes: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        fields.check_choice(self.reference, "reference", REFERENCES)
        fields.check_choice(self.tips, "tips", TIP_GEOMETRIES)
        arrays.check_number(self.period, "period", above=0.0)
        arrays.check_number(self.duration, "duration", above=0.0)
        travel = arrays.check_array(self.travel, "travel", (3,))
        if self.reference == "turn" and not travel.any():
            raise InvalidInput("travel", self.travel, "a rotation vector that is not zero")


@dataclass(frozen=True, slots=True)
class SimulateOutput:
    """What to show and keep; nothing where None or False.

    Raises:
        InvalidInput: a file or a directory that cannot be written to; said before anything moves, not after.
    """

    view: bool
    video: Path | None
    frames: Path | None
    save: Path | None
    plots: Path | None

    def __post_init__(self) -> None:
        check_new_file(self.video, "--video")
        check_new_folder(self.frames, "--frames")
        check_new_file(self.save, "--save")
        check_new_folder(self.plots, "--plots")

    @property
    def needs_images(self) -> bool:
        """Whether somebody will see the plant."""
        return self.view or self.video is not None or self.frames is not None


@dataclass(frozen=True, slots=True)
class ServiceOptions:
    """The service in which the controller runs, and how the plant's time goes meanwhile.

    Args:
        address: its Zenoh endpoint; None for one that is started for the run, in a process of its own.
        pace: lockstep or real, as `StreamController` says.

    Raises:
        InvalidInput: another pace.
    """

    address: str | None
    pace: str = "lockstep"

    def __post_init__(self) -> None:
        fields.check_choice(self.pace, "pace", PACES)


def run(options: SimulateOptions, output: SimulateOutput, console: Console, service: ServiceOptions | None = None) -> bool:
    """Find a hold, simulate, show.

    Args:
        wish: what to simulate.
        output: what to show and keep.
        console: where the progress and the figures go.
        service: where the controller runs; None for this process.

    Returns:
        Whether every fingertip touched all the time, and no contact force left its cone.

    Raises:
        InvalidInput: a wish that cannot be, or a display that is not there.
        ServiceError: no service, or it does not serve the hand.
    """
    if output.view and (why := simulation.missing_display_reason()):
        raise InvalidInput("--view", True, f"absent where there is no display ({why}); --video or --frames show the same")
    pushes = [_parse_push(push) for push in options.pushes]
    with ExitStack() as stack:
        client = None if service is None else stack.enter_context(_connect(service, options.grasp.hand_name, console))
        grasp = options.grasp.search(console)
        plant = Plant(_build_scene(options, grasp, output.needs_images, console), disturbances=pushes)
        settings = ControlSettings(gravity_H=options.grasp.gravity_H)
        driver = None
        if service is not None and client is not None:
            real_time = service.pace == "real"
            stream = client.open_stream(grasp, settings, validity=DEFAULT_VALIDITY if real_time else _LOCKSTEP_VALIDITY)
            driver = StreamController(stack.enter_context(stream), real_time=real_time)
        callbacks: list[StepCallback] = []
        if output.video is not None or output.frames is not None:
            callbacks.append(stack.enter_context(_film_callback(plant, output, console)))
        if output.view:
            callbacks.append(stack.enter_context(_viewer_callback()))
        callbacks.append(stack.enter_context(progress(options.duration, console)))

        def watch(plant: Plant, command: ControllerCommand) -> None:
            for callback in callbacks:
                callback(plant, command)

        local_controller, initial_forces = ObjectController(grasp, settings), None
        if driver is not None:  # asked here, so that the first state that the stream sees is one of the run
            first = local_controller.step(plant.reset(), BodyMotion(grasp.p_HO, grasp.R_HO))
            initial_forces = None if first.forces_reused else first.f
        follow = reference(options, grasp)
        recording = simulation.simulate(
            plant, driver or local_controller, follow, options.duration, initial_forces=initial_forces, on_step=watch
        )
    console.print(summary_table(recording, driver))
    for when, text in recording.warnings[:5]:
        console.print(f"[yellow]{when:.3f} s: {text}[/]")
    if output.save is not None:
        output.save.parent.mkdir(parents=True, exist_ok=True)
        recording.save(output.save)
        console.print(f"Everything, step by step: [bold]{output.save}[/]", soft_wrap=True)
    if output.plots is not None:
        from graspforce.simulation import plots

        for path in plots.save_plots(recording, output.plots):
            console.print(f"Plot: [bold]{path}[/]", soft_wrap=True)
    metrics = simulation.compute_metrics(recording)
    return metrics.lost_contact_steps == 0 and metrics.slip_steps == 0


def _parse_push(numbers: tuple[float, ...]) -> simulation.Push:
    """A push as the option says it."""
    try:
        return simulation.Push(np.array(numbers[:3]), numbers[3], numbers[4])
    except InvalidInput as error:
        raise error.with_prefix("push") from None


def _build_scene(options: SimulateOptions, grasp: Grasp, is_rendered: bool, console: Console) -> Scene:
    """The scene; where it is seen the hand looks like its meshes, if these are there. Those that were pointed at must be."""
    build_scene = partial(
        simulation.build_scene, grasp, gravity_H=options.grasp.gravity_H, tips=options.tips, directories=options.meshes
    )
    if options.meshes or not is_rendered:
        return build_scene(skin=bool(options.meshes))
    try:
        return build_scene(skin=True)
    except ModelError as error:
        scene = build_scene()
        console.print(f"Links are drawn as bars: {error}", soft_wrap=True)
        return scene


def reference(options: SimulateOptions, grasp: Grasp) -> Reference:
    """The motion to follow."""
    start, travel = BodyMotion(grasp.p_HO, grasp.R_HO), np.array(options.travel)
    if options.reference == "still":
        return simulation.constant_reference(start)
    if options.reference == "reach":
        return simulation.linear_reference(start, travel, options.period)
    if options.reference == "sine":
        return simulation.sine_reference(start, travel / 2.0, options.period)
    angle = float(np.linalg.norm(travel))
    return simulation.rotation_reference(start, travel / angle, angle, options.period)


def summary_table(recording: Recording, driver: StreamController | None = None) -> Table:
    """The figures at the end; with a driver, those of its stream too."""
    metrics = simulation.compute_metrics(recording)
    table = Table("figure", "value", title=f"{recording.hand}, {recording.t[-1] + recording.t[1]:.3g} s in closed loop")
    table.add_row(
        "the object is where it should be to",
        f"{1e3 * metrics.position_error_rms:.4f} mm RMS, {1e3 * metrics.position_error_peak:.4f} mm peak",
    )
    table.add_row(
        "its attitude to",
        f"{np.degrees(metrics.orientation_error_rms):.4f}° RMS, {np.degrees(metrics.orientation_error_peak):.4f}° peak",
    )
    table.add_row("least slip margin", f"{metrics.min_slip_margin:.3f} N (planned {metrics.min_planned_margin:.3f} N)")
    table.add_row(
        "forces outside their cones",
        "none" if metrics.max_cone_violation == 0.0 else f"up to {metrics.max_cone_violation:.2g} N",
    )
    table.add_row("planned and true contact forces differ by", f"{100.0 * metrics.force_error:.2f} % RMS")
    table.add_row("largest normal force", f"{recording.f[..., 2].max():.2f} N")
    table.add_row("busiest motor", f"{100.0 * metrics.max_torque_fraction:.0f} % of its limit")
    table.add_row("steps with a fingertip off the object", str(metrics.lost_contact_steps))
    table.add_row("steps with a fingertip that slides", str(metrics.slip_steps))
    table.add_row("steps without certified forces", str(metrics.held))
    if driver is not None:
        if driver.round_trips:
            median, tail = 1e3 * np.quantile(driver.round_trips, [0.5, 0.99])  # ms
            table.add_row("from a state to its command over Zenoh", f"{median:.2f} ms median, {tail:.2f} ms at 99 %")
        table.add_row("steps with an earlier state's command", str(driver.stale_steps))
        table.add_row("steps with the watchdog's torque", str(driver.late))
    return table


@contextmanager
def _connect(service: ServiceOptions, hand: str, console: Console) -> Iterator[Client]:
    """A way to the service, which is started where there is none."""
    with ExitStack() as stack:
        address = service.address
        if address is None:
            with console.status("Starting the service"):
                address = stack.enter_context(start_server_process(hand)).address
        client = stack.enter_context(Client(address, timeout=_SERVICE_TIMEOUT))
        console.print(f"The controller runs in the service at [bold]{address}[/], the hand here.", soft_wrap=True)
        yield client


# ── watchers ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


@contextmanager
def progress(duration: float, console: Console) -> Iterator[StepCallback]:
    """A bar that fills while a simulation runs."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.2f} of {task.total:g} s"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("Simulating", total=duration)

        def watch(plant: Plant, command: ControllerCommand) -> None:
            if round(plant.t / plant.dt) % 20 == 0:
                off = 1e3 * float(np.linalg.norm(command.error[:3]))
                bar.update(task, completed=plant.t, description=f"Simulating, {off:.3f} mm off")

        yield watch
        bar.update(task, completed=duration)


@contextmanager
def _viewer_callback() -> Iterator[StepCallback]:
    """MuJoCo's own viewer, in real time where the machine keeps up; who closes it does not wait for the rest."""
    with ExitStack() as stack:
        opened: list[Any] = []
        begun = time.monotonic()

        def watch(plant: Plant, command: ControllerCommand) -> None:
            nonlocal begun
            if not opened:
                opened.append(stack.enter_context(simulation.open_viewer(plant)))
                begun = time.monotonic()
            if round(plant.t / plant.dt) % 16 == 0 and opened[0].is_running():
                opened[0].sync()
                time.sleep(max(plant.t - (time.monotonic() - begun), 0.0))

        yield watch


@contextmanager
def _film_callback(plant: Plant, output: SimulateOutput, console: Console) -> Iterator[StepCallback]:
    """A film, and its pictures one by one."""
    import imageio.v2 as imageio

    renderer = simulation.make_renderer(plant)
    console.print(f"Pictures are {renderer.description}.", soft_wrap=True)
    count = 0
    with ExitStack() as stack:
        writer: Any = None
        if output.video is not None:
            output.video.parent.mkdir(parents=True, exist_ok=True)
            writer = stack.enter_context(_open_film(imageio, output.video))
        if output.frames is not None:
            output.frames.mkdir(parents=True, exist_ok=True)

        def watch(plant: Plant, command: ControllerCommand) -> None:
            nonlocal count
            if plant.t * _FRAME_RATE < count - 1e-6:  # rounding of many steps' times
                return
            picture = renderer.render(plant)
            if writer is not None:
                writer.append_data(picture)
            if output.frames is not None:
                imageio.imwrite(output.frames / f"{count:05d}.png", picture)
            count += 1

        yield watch
    for what in (output.video, output.frames):
        if what is not None:
            console.print(f"{count} pictures: [bold]{what}[/]", soft_wrap=True)


def _open_film(imageio: Any, path: Path) -> Any:
    try:
        rate = {"duration": 1000.0 / _FRAME_RATE, "loop": 0} if path.suffix == ".gif" else {"fps": _FRAME_RATE}
        return imageio.get_writer(path, **rate)
    except (ValueError, OSError, ImportError) as error:
        raise InvalidInput(
            "--video", str(path), f"a file that a film can be written to, such as film.mp4 or film.gif: {error}"
        ) from None
