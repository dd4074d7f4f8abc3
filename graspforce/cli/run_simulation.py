"""The command ``graspforce simulate``: find a grasp, simulate the closed loop in MuJoCo, show a summary, write files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from graspforce import simulation
from graspforce.cli.film_format import FilmFormat
from graspforce.cli.heat_tables import heat_record, heat_table
from graspforce.cli.interruption import Interruption
from graspforce.cli.json_output import put_result
from graspforce.cli.live_view import live_view
from graspforce.cli.options import is_enveloping
from graspforce.cli.output_files import check_new_file, check_new_folder
from graspforce.cli.reference_motion import check_reference, choose_travel, make_reference
from graspforce.cli.simulate_options import SimulateOptions
from graspforce.cli.step_callbacks import FilmOptions, StepCallback, film_callback, progress_bar, viewer_callback
from graspforce.cli.stream_controller import StreamController
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.core import fields
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import relax_idle_fingers
from graspforce.hand.contact_tips import has_contact_tips
from graspforce.hand.heat import report_heat
from graspforce.service import DEFAULT_VALIDITY, Client, start_server_process
from graspforce.simulation import ControllerCommand, Plant, PlantInterface, Recording, Reference, Scene, World
from graspforce.simulation.plants.scene import TIP_GEOMETRIES
from graspforce.simulation.rendering import missing_display_reason
from graspforce.simulation.worlds.world_plants import with_drives

PACES = ("lockstep", "real")
VIEWS = ("window", "browser")
LOCKSTEP_VALIDITY = 0.2  # s: in lockstep the plant waits for each command, so that commands do not age
_SERVICE_TIMEOUT = 5.0  # s: a new service imports and compiles before its first answer
_MAX_WARNINGS = 5  # shown


@dataclass(frozen=True, slots=True)
class SimulateOutput:
    """The files and the view of a simulation; None for those that are not wanted.

    Args:
        view: "window" for MuJoCo's viewer, "browser" for a web page.
        video: file of the film.
        frames: directory of the film's frames.
        save: file of the recording.
        plots: directory of the plots.
        record: MCAP file of the recording.
        force: whether existing files are replaced; pictures in directories always are.
        film: size, rate and viewpoint of the film.

    Raises:
        InvalidInput: another view, no display for a window, or a file or a directory cannot be written.
    """

    view: str | None
    video: Path | None
    frames: Path | None
    save: Path | None
    plots: Path | None
    record: Path | None = None
    force: bool = True
    film: FilmFormat = field(default_factory=FilmFormat)

    def __post_init__(self) -> None:
        if self.view is not None:
            fields.check_choice(self.view, "--view", VIEWS)
        if self.view == "window" and (reason := missing_display_reason()):
            allowed = f"browser or absent, because there is no display ({reason}); use --video or --frames"
            raise InvalidInput("--view", self.view, allowed)
        check_new_file(self.video, "--video", self.force)
        check_new_folder(self.frames, "--frames")
        check_new_file(self.save, "--save", self.force)
        check_new_file(self.record, "--record", self.force)
        check_new_folder(self.plots, "--plots")


@dataclass(frozen=True, slots=True)
class ServiceOptions:
    """The service that runs the controller.

    Args:
        address: its Zenoh endpoint; None to start a service in a process of its own.
        pace: lockstep or real, see `StreamController`.

    Raises:
        InvalidInput: another pace.
    """

    address: str | None
    pace: str = "lockstep"

    def __post_init__(self) -> None:
        fields.check_choice(self.pace, "pace", PACES)


def run(
    options: SimulateOptions,
    output: SimulateOutput,
    console: Console,
    service: ServiceOptions | None = None,
    reference_of: Callable[[SimulateOptions, Grasp], Reference] | None = None,
) -> bool:
    """Find a grasp, simulate, and show the results.

    Args:
        options: the simulation.
        output: files and windows.
        console: shows progress and results.
        service: where the controller runs; None for this process.
        reference_of: makes the reference motion; by default `make_reference`.

    Returns:
        Whether all fingertips kept contact and none slipped.

    Raises:
        InvalidInput: an option is impossible, no grasp was found, or a display is missing.
        ServiceError: the service is missing or does not serve the hand.
    """
    pushes = [_parse_push(push) for push in options.pushes]
    if service is not None and is_enveloping(options.grasp.requirements):
        allowed = "a class of fingertips with a service: streams take no contacts on inner links or the palm"
        name = getattr(options.grasp.requirements.grasp_class, "value", None)
        raise InvalidInput("--class", name, allowed)
    with ExitStack() as stack:
        client = None if service is None else stack.enter_context(connect_service(service, options.grasp.hand_name, console))
        options, grasp = start_grasp(options, console)
        gravity_H, tips = options.grasp.gravity_H, fields.check_choice(options.tips, "tips", TIP_GEOMETRIES)
        scene = simulation.build_scene(grasp, gravity_H=gravity_H, tip_geometry=tips, directories=options.meshes)
        plant = Plant(scene, disturbances=pushes)
        driven_plant = with_drives(plant, World.nominal(), grasp)
        settings = ControlSettings(gravity_H=gravity_H)
        remote_controller = None
        if service is not None and client is not None:
            real_time = service.pace == "real"
            stream = client.open_stream(grasp, settings, validity=DEFAULT_VALIDITY if real_time else LOCKSTEP_VALIDITY)
            remote_controller = StreamController(stack.enter_context(stream), real_time=real_time)
        callbacks = _callbacks(plant, options, output, console, stack)
        live = (
            stack.enter_context(live_view(plant, settings.slip_margin, options.meshes, console))
            if output.view == "browser"
            else None
        )
        reference = (reference_of or make_reference)(options, grasp)
        interruption = stack.enter_context(Interruption())

        def on_step(_: PlantInterface, command: ControllerCommand) -> bool:
            for callback in callbacks:
                callback(plant, command)
            return not interruption.is_requested and (live is None or live.follow(plant, command))

        local_controller, initial_forces = ObjectController(grasp, settings), None
        if remote_controller is not None:  # computed here, so that the stream's first state belongs to the run
            first = local_controller.step(plant.reset(), BodyMotion(grasp.p_HO, grasp.R_HO))
            initial_forces = None if first.forces_reused else first.f
        recording = simulation.simulate(
            driven_plant,
            remote_controller or (local_controller if live is None else live.steered(local_controller)),
            reference if live is None else live.steered_reference(reference),
            options.duration,
            initial_forces=initial_forces,
            on_step=on_step,
        )
    _show(recording, output, console, remote_controller, options.pushes)
    if output.record is not None:
        write_mcap(recording, scene, output.record, options.meshes, console)
    heat = show_heat(recording, grasp, console)
    metrics = simulation.compute_metrics(recording)
    is_held = metrics.lost_contact_steps == 0 and metrics.slip_steps == 0
    record = {"hand": recording.hand, "is_held": is_held, "metrics": metrics, "warnings": recording.warnings}
    put_result(console, {**record, **heat})
    return is_held


def start_grasp(options: SimulateOptions, console: Console) -> tuple[SimulateOptions, Grasp]:
    """Return options with a travel, and the grasp in which a simulation starts, whose contacts allow the reference motion.

    Args:
        options: the simulation.
        console: shows the grasp.

    Raises:
        InvalidInput: no grasp was found, or the motion is not possible in it.
    """
    grasp = options.grasp.search(console)
    if not has_contact_tips(grasp.hand, grasp.fingers):
        grasp = relax_idle_fingers(grasp)
    options = choose_travel(options, grasp, console)
    check_reference(options, grasp)
    return options, grasp


def show_heat(recording: Recording, grasp: Grasp, console: Console) -> JsonRecord:
    """Print the temperatures of the motors if the hand's drives have thermal data, and return their record as `heat`.

    Args:
        recording: the run.
        grasp: its grasp.
        console: shows the table.
    """
    report = report_heat(grasp.hand, recording.t, recording.tau, grasp.fingers)
    if report is None:
        return {}
    console.print(heat_table(grasp.hand, report, grasp.fingers, len(recording.t) * (recording.t[1] - recording.t[0])))
    return {"heat": heat_record(report)}


def _callbacks(
    plant: Plant, options: SimulateOptions, output: SimulateOutput, console: Console, stack: ExitStack
) -> list[StepCallback]:
    """Return the callbacks of film, viewer and progress bar; the stack closes them."""
    callbacks: list[StepCallback] = []
    film = FilmOptions(output.video, output.frames, options.duration, options.meshes, format=output.film)
    if film.is_wanted:
        callbacks.append(stack.enter_context(film_callback(plant, film, console)))
    if output.view == "window":
        callbacks.append(stack.enter_context(viewer_callback(plant, options.meshes)))
    callbacks.append(stack.enter_context(progress_bar(options.duration)))
    return callbacks


def _show(
    recording: Recording,
    output: SimulateOutput,
    console: Console,
    remote_controller: StreamController | None,
    pushes: Sequence[tuple[float, ...]],
) -> None:
    """Print the summary and the first warnings, and write the recording and the plots."""
    console.print(summary_table(recording, remote_controller))
    for t, text in recording.warnings[:_MAX_WARNINGS]:
        console.print(f"[yellow]{t:.3f} s: {text}[/]")
    if output.save is not None:
        output.save.parent.mkdir(parents=True, exist_ok=True)
        recording.save(output.save)
        console.print(f"Recording: [bold]{output.save}[/]", soft_wrap=True)
    if output.plots is not None:
        from graspforce.simulation.recordings import recording_plots

        for path in recording_plots.save_plots(recording, output.plots, pushes):
            console.print(f"Plot: [bold]{path}[/]", soft_wrap=True)


def _parse_push(numbers: tuple[float, ...]) -> simulation.Push:
    """Return the push of five numbers: force, start and duration."""
    try:
        return simulation.Push(np.array(numbers[:3]), numbers[3], numbers[4])
    except InvalidInput as error:
        raise error.with_prefix("push") from None


def summary_table(recording: Recording, remote_controller: StreamController | None = None) -> Table:
    """Return the metrics of a run as a table; with a remote controller those of its stream, too."""
    metrics = simulation.compute_metrics(recording)
    table = Table("metric", "value", title=f"{recording.hand}, {recording.t[-1] + recording.t[1]:.3g} s in closed loop")
    rms, peak = 1e3 * metrics.position_error_rms, 1e3 * metrics.position_error_peak  # mm
    table.add_row("position error", f"{rms:.4f} mm RMS, {peak:.4f} mm peak")
    rms, peak = np.degrees(metrics.orientation_error_rms), np.degrees(metrics.orientation_error_peak)
    table.add_row("orientation error", f"{rms:.4f}° RMS, {peak:.4f}° peak")
    margins = f"{metrics.min_slip_margin:.3f} N (planned {metrics.min_planned_margin:.3f} N)"
    table.add_row("minimum slip margin", margins)
    outside = metrics.max_cone_violation
    table.add_row("forces outside their friction cones", "none" if outside == 0.0 else f"up to {outside:.2g} N")
    table.add_row("contact-force error, planned to true", f"{100.0 * metrics.force_error:.2f} % RMS")
    table.add_row("maximum normal force", f"{recording.f[..., 2].max():.2f} N")
    table.add_row("maximum motor torque", f"{100.0 * metrics.max_torque_fraction:.0f} % of its limit")
    table.add_row("steps with a lost contact", str(metrics.lost_contact_steps))
    table.add_row("steps with a slipping fingertip", str(metrics.slip_steps))
    table.add_row("steps without certified forces", str(metrics.reused_force_steps))
    if recording.collisions:
        t, first, second, _ = recording.collisions[0]
        largest = max(force for *_, force in recording.collisions)
        words = f"{len(recording.collisions)}, first {first} and {second} at {t:.3f} s, up to {largest:.2f} N"
        table.add_row("collisions of links", words)
    if remote_controller is not None:
        if remote_controller.round_trips:
            median, tail = 1e3 * np.quantile(remote_controller.round_trips, [0.5, 0.99])  # ms
            table.add_row("round trip over Zenoh, state to command", f"{median:.2f} ms median, {tail:.2f} ms at 99 %")
        table.add_row("steps with the command of an earlier state", str(remote_controller.stale_steps))
        table.add_row("steps with the watchdog's torque", str(remote_controller.late))
    return table


def service_options(connect: str | None, serve: bool, pace: str = "lockstep") -> ServiceOptions | None:
    """Return the service of the command-line options; None for none.

    Args:
        connect: Zenoh endpoint of a running service.
        serve: whether to start a service.
        pace: ``lockstep`` or ``real``.

    Raises:
        InvalidInput: the options exclude each other.
    """
    if serve and connect is not None:
        raise InvalidInput("--connect", connect, "given without --serve, which starts its own service")
    return ServiceOptions(connect, pace) if serve or connect is not None else None


@contextmanager
def connect_service(service: ServiceOptions, hand: str, console: Console) -> Iterator[Client]:
    """Connect to the service, which is started if it has no address.

    Args:
        service: the service.
        hand: name of the hand that a new service serves.
        console: shows the address.
    """
    with ExitStack() as stack:
        address = service.address
        if address is None:
            with console.status("Starting the service"):
                address = stack.enter_context(start_server_process(hand)).address
        client = stack.enter_context(Client(address, timeout=_SERVICE_TIMEOUT))
        console.print(f"The controller runs in the service at [bold]{address}[/], the plant in this process.", soft_wrap=True)
        yield client


def write_mcap(recording: Recording, scene: Scene, file: Path, directories: tuple[Path, ...], console: Console) -> None:
    """Write a recording as an MCAP file, and print its name.

    Args:
        recording: the recording.
        scene: scene of its grasp.
        file: the file.
        directories: directories to search for mesh files.
        console: shows progress and the file.
    """
    from graspforce.simulation.rendering.mcap_file import save_mcap

    file.parent.mkdir(parents=True, exist_ok=True)
    with console.status("Writing the MCAP file"):
        save_mcap(recording, scene, file, directories)
    console.print(f"MCAP: [bold]{file}[/]", soft_wrap=True)
