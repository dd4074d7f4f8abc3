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

from graspforce import arrays, fields, simulation
from graspforce.body import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.driver import Driver
from graspforce.errors import InvalidInput, ModelError
from graspforce.hold import Hold
from graspforce.options import HoldWish, new_file, new_folder
from graspforce.service import VALIDITY, Client, own_process
from graspforce.simulation import Commanded, Plant, Recording, Reference, Scene
from graspforce.simulation.scene import TIPS

Watcher = Callable[[Plant, Commanded], None]

PACES = ("lockstep", "real")
REFERENCES = ("still", "reach", "sine", "turn")
_FRAMES = 30  # a second
_PAUSE = 0.2  # s: in lockstep the plant stands still while it waits, so that a command is as good as new
_PATIENCE = 5.0  # s: a service that has just begun imports and compiles before its first answer


@dataclass(frozen=True, slots=True)
class Wish:
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

    hold: HoldWish
    reference: str
    travel: tuple[float, ...]
    period: float
    duration: float
    pushes: tuple[tuple[float, ...], ...]
    tips: str = "ball"
    meshes: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        fields.choice(self.reference, "reference", REFERENCES)
        fields.choice(self.tips, "tips", TIPS)
        arrays.number(self.period, "period", above=0.0)
        arrays.number(self.duration, "duration", above=0.0)
        travel = arrays.array(self.travel, "travel", (3,))
        if self.reference == "turn" and not travel.any():
            raise InvalidInput("travel", self.travel, "a rotation vector that is not zero")


@dataclass(frozen=True, slots=True)
class Output:
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
        new_file(self.video, "--video")
        new_folder(self.frames, "--frames")
        new_file(self.save, "--save")
        new_folder(self.plots, "--plots")

    @property
    def pictures(self) -> bool:
        """Whether somebody will see the plant."""
        return self.view or self.video is not None or self.frames is not None


@dataclass(frozen=True, slots=True)
class Service:
    """The service in which the controller runs, and how the plant's time goes meanwhile.

    Args:
        address: its Zenoh endpoint; None for one that is started for the run, in a process of its own.
        pace: lockstep or real, as `Driver` says.

    Raises:
        InvalidInput: another pace.
    """

    address: str | None
    pace: str = "lockstep"

    def __post_init__(self) -> None:
        fields.choice(self.pace, "pace", PACES)


def run(wish: Wish, output: Output, console: Console, service: Service | None = None) -> bool:
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
    if output.view and (why := simulation.no_display()):
        raise InvalidInput("--view", True, f"absent where there is no display ({why}); --video or --frames show the same")
    pushes = [_push(push) for push in wish.pushes]
    with ExitStack() as stack:
        client = None if service is None else stack.enter_context(_client(service, wish.hold.hand_name, console))
        hold = wish.hold.find(console)
        plant = Plant(_scene(wish, hold, output.pictures, console), disturbances=pushes)
        settings = ControlSettings(gravity_H=wish.hold.gravity_H)
        driver = None
        if service is not None and client is not None:
            real_time = service.pace == "real"
            stream = client.open_stream(hold, settings, validity=VALIDITY if real_time else _PAUSE)
            driver = Driver(stack.enter_context(stream), real_time=real_time)
        watchers: list[Watcher] = []
        if output.video is not None or output.frames is not None:
            watchers.append(stack.enter_context(_pictures(plant, output, console)))
        if output.view:
            watchers.append(stack.enter_context(_view()))
        watchers.append(stack.enter_context(progress(wish.duration, console)))

        def watch(plant: Plant, command: Commanded) -> None:
            for watcher in watchers:
                watcher(plant, command)

        own, begin = ObjectController(hold, settings), None
        if driver is not None:  # asked here, so that the first state that the stream sees is one of the run
            first = own.step(plant.reset(), BodyMotion(hold.p_HO, hold.R_HO))
            begin = None if first.held else first.f
        follow = reference(wish, hold)
        recording = simulation.simulate(plant, driver or own, follow, wish.duration, begin=begin, on_step=watch)
    console.print(summary(recording, driver))
    for when, text in recording.warnings[:5]:
        console.print(f"[yellow]{when:.3f} s: {text}[/]")
    if output.save is not None:
        output.save.parent.mkdir(parents=True, exist_ok=True)
        recording.save(output.save)
        console.print(f"Everything, step by step: [bold]{output.save}[/]", soft_wrap=True)
    if output.plots is not None:
        from graspforce.simulation import plots

        for path in plots.draw(recording, output.plots):
            console.print(f"Plot: [bold]{path}[/]", soft_wrap=True)
    got = simulation.figures(recording)
    return got.lost == 0 and got.slid == 0


def _push(said: tuple[float, ...]) -> simulation.Push:
    """A push as the option says it."""
    try:
        return simulation.Push(np.array(said[:3]), said[3], said[4])
    except InvalidInput as error:
        raise error.inside("push") from None


def _scene(wish: Wish, hold: Hold, seen: bool, console: Console) -> Scene:
    """The scene; where it is seen the hand looks like its meshes, if these are there. Those that were pointed at must be."""
    build = partial(simulation.build, hold, gravity_H=wish.hold.gravity_H, tips=wish.tips, directories=wish.meshes)
    if wish.meshes or not seen:
        return build(skin=bool(wish.meshes))
    try:
        return build(skin=True)
    except ModelError as error:
        scene = build()
        console.print(f"Links are drawn as bars: {error}", soft_wrap=True)
        return scene


def reference(wish: Wish, hold: Hold) -> Reference:
    """The motion to follow."""
    start, travel = BodyMotion(hold.p_HO, hold.R_HO), np.array(wish.travel)
    if wish.reference == "still":
        return simulation.still(start)
    if wish.reference == "reach":
        return simulation.reach(start, travel, wish.period)
    if wish.reference == "sine":
        return simulation.sine(start, travel / 2.0, wish.period)
    angle = float(np.linalg.norm(travel))
    return simulation.turn(start, travel / angle, angle, wish.period)


def summary(recording: Recording, driver: Driver | None = None) -> Table:
    """The figures at the end; with a driver, those of its stream too."""
    got = simulation.figures(recording)
    table = Table("figure", "value", title=f"{recording.hand}, {recording.t[-1] + recording.t[1]:.3g} s in closed loop")
    table.add_row(
        "the object is where it should be to", f"{1e3 * got.tracking_rms:.4f} mm RMS, {1e3 * got.tracking_peak:.4f} mm peak"
    )
    table.add_row("its attitude to", f"{np.degrees(got.turn_rms):.4f}° RMS, {np.degrees(got.turn_peak):.4f}° peak")
    table.add_row("least slip margin", f"{got.least_margin:.3f} N (planned {got.least_planned_margin:.3f} N)")
    table.add_row("forces outside their cones", "none" if got.outside == 0.0 else f"up to {got.outside:.2g} N")
    table.add_row("planned and true contact forces differ by", f"{100.0 * got.force_error:.2f} % RMS")
    table.add_row("largest normal force", f"{recording.f[..., 2].max():.2f} N")
    table.add_row("busiest motor", f"{100.0 * got.torque_share:.0f} % of its limit")
    table.add_row("steps with a fingertip off the object", str(got.lost))
    table.add_row("steps with a fingertip that slides", str(got.slid))
    table.add_row("steps without certified forces", str(got.held))
    if driver is not None:
        if driver.round_trips:
            median, tail = 1e3 * np.quantile(driver.round_trips, [0.5, 0.99])  # ms
            table.add_row("from a state to its command over Zenoh", f"{median:.2f} ms median, {tail:.2f} ms at 99 %")
        table.add_row("steps with an earlier state's command", str(driver.earlier))
        table.add_row("steps with the watchdog's torque", str(driver.late))
    return table


@contextmanager
def _client(service: Service, hand: str, console: Console) -> Iterator[Client]:
    """A way to the service, which is started where there is none."""
    with ExitStack() as stack:
        address = service.address
        if address is None:
            with console.status("Starting the service"):
                address = stack.enter_context(own_process(hand)).address
        client = stack.enter_context(Client(address, timeout=_PATIENCE))
        console.print(f"The controller runs in the service at [bold]{address}[/], the hand here.", soft_wrap=True)
        yield client


# ── watchers ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


@contextmanager
def progress(duration: float, console: Console) -> Iterator[Watcher]:
    """A bar that fills while a simulation runs."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.2f} of {task.total:g} s"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("Simulating", total=duration)

        def watch(plant: Plant, command: Commanded) -> None:
            if round(plant.t / plant.dt) % 20 == 0:
                off = 1e3 * float(np.linalg.norm(command.error[:3]))
                bar.update(task, completed=plant.t, description=f"Simulating, {off:.3f} mm off")

        yield watch
        bar.update(task, completed=duration)


@contextmanager
def _view() -> Iterator[Watcher]:
    """MuJoCo's own viewer, in real time where the machine keeps up; who closes it does not wait for the rest."""
    with ExitStack() as stack:
        opened: list[Any] = []
        begun = time.monotonic()

        def watch(plant: Plant, command: Commanded) -> None:
            nonlocal begun
            if not opened:
                opened.append(stack.enter_context(simulation.window(plant)))
                begun = time.monotonic()
            if round(plant.t / plant.dt) % 16 == 0 and opened[0].is_running():
                opened[0].sync()
                time.sleep(max(plant.t - (time.monotonic() - begun), 0.0))

        yield watch


@contextmanager
def _pictures(plant: Plant, output: Output, console: Console) -> Iterator[Watcher]:
    """A film, and its pictures one by one."""
    import imageio.v2 as imageio

    artist = simulation.artist(plant)
    console.print(f"Pictures are {artist.words}.", soft_wrap=True)
    count = 0
    with ExitStack() as stack:
        writer: Any = None
        if output.video is not None:
            output.video.parent.mkdir(parents=True, exist_ok=True)
            writer = stack.enter_context(_writer(imageio, output.video))
        if output.frames is not None:
            output.frames.mkdir(parents=True, exist_ok=True)

        def watch(plant: Plant, command: Commanded) -> None:
            nonlocal count
            if plant.t * _FRAMES < count - 1e-6:  # rounding of many steps' times
                return
            picture = artist.frame(plant)
            if writer is not None:
                writer.append_data(picture)
            if output.frames is not None:
                imageio.imwrite(output.frames / f"{count:05d}.png", picture)
            count += 1

        yield watch
    for what in (output.video, output.frames):
        if what is not None:
            console.print(f"{count} pictures: [bold]{what}[/]", soft_wrap=True)


def _writer(imageio: Any, path: Path) -> Any:
    try:
        rate = {"duration": 1000.0 / _FRAMES, "loop": 0} if path.suffix == ".gif" else {"fps": _FRAMES}
        return imageio.get_writer(path, **rate)
    except (ValueError, OSError, ImportError) as error:
        raise InvalidInput(
            "--video", str(path), f"a file that a film can be written to, such as film.mp4 or film.gif: {error}"
        ) from None
