"""Loss of the control server during a motion: python -m benchmarks.lost_server [--save FILE].

A ball of 50 g moves out and back once per second in MuJoCo, in real time, over 10 mm or 5 mm. On dlr_hit2 the thumb reaches its
torque limits above 5 mm, even with a server. The controller runs in a service. Its process is killed when the ball is fastest,
and restarted a second later. In between, the driver's watchdog holds the ball. Its settings are the defaults, with a hold time
longer than the start of a process. The simulation runs in real time, so that load on the machine affects the outcome.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks import report_page
from benchmarks.closed_loop import three_finger_grasp
from benchmarks.mujoco_loop import EARTH, PALM_UP
from graspforce import Hand, simulation
from graspforce.cli.stream_controller import StreamController
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings
from graspforce.core.arrays import Array
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp, travel_limits
from graspforce.service import Client, RemoteCommand, Watchdog, start_server_process
from graspforce.simulation import ControllerCommand, Plant, Recording

# The restart follows more than 1 s after the loss, so that the outage exceeds 1 s even if the process starts at once.
LOSS, RESTART, END = 1.25, 2.3, 7.0  # s: kill of the server, restart, end of the run
WATCHDOG = Watchdog(hold=END)


@dataclass(frozen=True, slots=True)
class Row:
    """Outcome of one loss.

    Attributes:
        label: hand and travel.
        outage: time without commands, s.
        moved: largest displacement of the object after the kill, m; it is braked only when the last command has expired.
        creep: displacement of the object in the second half of the outage, m.
        margin: least slip margin of the plant's contacts from the loss until the new commands are reached, N.
        steps_without_contact: number of steps of the whole run in which a fingertip did not touch.
        max_torque_step: largest change of a joint's torque per period, from the loss until the new commands are reached, N·m.
        recovery: time from the first new command until the new commands are reached, s.
        error: largest position error of the object in the last 0.1 s, m.
    """

    label: str
    outage: float
    moved: float
    creep: float
    margin: float
    steps_without_contact: int
    max_torque_step: float
    recovery: float
    error: float

    @property
    def met(self) -> bool:
        """Return whether the object stays in the hand for at least 1 s, and torque changes stay within their limit."""
        bound = WATCHDOG.step * (1.0 + 1e-9)  # rounding
        return (
            self.outage >= 1.0
            and self.steps_without_contact == 0
            and self.margin > 0.0
            and self.max_torque_step <= bound
            and self.error < 1e-4
        )


# Grasp, gravity and travel. The ball moves up, or between planar fingers in their most upward direction.
GRASPS: dict[str, Callable[[], tuple[Grasp, Array, float]]] = {
    "allegro_right, three fingers, 10 mm": lambda: (three_finger_grasp(), PALM_UP, 0.01),
    "four_finger, 10 mm": lambda: (_find_grasp("four_finger"), EARTH, 0.01),
    "anthropomorphic15, 5 mm": lambda: (_find_grasp("anthropomorphic15"), EARTH, 0.005),
    "dlr_hit2, 5 mm": lambda: (_find_grasp("dlr_hit2"), EARTH, 0.005),
}


def _find_grasp(name: str) -> Grasp:
    return find_grasp(Hand.load(name), Body.solid(Sphere(0.03), 0.05), friction=0.7, gravity_H=EARTH)


def main() -> None:
    """Measure, print the table and write the page."""
    options = report_page.parser("lost_server", __doc__).parse_args()
    bound = f"largest torque step (limit {WATCHDOG.step:g} N·m)"
    heads = ["hand", "outage", "ball moved", "in the second half", "least slip margin", "steps without contact"]
    heads += [bound, "recovery", "position error at the end", "held"]
    lines: list[list[str]] = []
    for label, grasp in GRASPS.items():
        row = run_with_server_loss(label, *grasp())
        cells = [
            row.label,
            f"{row.outage:.3f} s",
            f"{1e3 * row.moved:.3f} mm",
            f"{1e6 * row.creep:.2f} µm",
            f"{row.margin:.3f} N",
        ]
        cells += [
            str(row.steps_without_contact),
            f"{row.max_torque_step:.4f} N·m",
            f"{row.recovery:.3f} s",
            f"{1e3 * row.error:.3f} mm",
        ]
        cells += ["yes" if row.met else "no"]
        lines.append(cells)
    title = "Loss of the control server during a motion"
    report_page.show(title, heads, lines, width=180)
    if options.save:
        facts = report_page.facts(f"MuJoCo {mujoco.__version__}")
        report_page.save(options.save, title, __doc__, facts, report_page.table(heads, lines))


def run_with_server_loss(label: str, grasp: Grasp, gravity_H: Array, travel: float) -> Row:
    """Simulate a motion with the loss and the restart of the server, and return its figures.

    Args:
        label: hand and travel.
        grasp: the grasp at the start.
        gravity_H: (3,) gravity in H, m/s².
        travel: travel of the ball, m.
    """
    plant = Plant(simulation.build_scene(grasp, gravity_H=gravity_H))
    limit = max(travel_limits(grasp, travel), key=lambda limit: float(limit.direction @ -gravity_H))
    follow = simulation.linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), travel * limit.direction, 1.0)
    commands: list[RemoteCommand] = []
    with ExitStack() as stack:
        first = stack.enter_context(start_server_process(grasp.hand.name))
        client = stack.enter_context(Client(first.address, timeout=10.0))
        returning = stack.enter_context(ExitStack())
        threads = stack.enter_context(ThreadPoolExecutor(1))
        stream = stack.enter_context(client.open_stream(grasp, ControlSettings(gravity_H=gravity_H), watchdog=WATCHDOG))
        driver = _RecordingDriver(StreamController(stream, real_time=True), commands)

        def watch(plant: Plant, command: ControllerCommand) -> None:
            step = round(plant.t / plant.dt)
            if step == round(LOSS / plant.dt):
                first.process.kill()
            elif step == round(RESTART / plant.dt):
                threads.submit(returning.enter_context, start_server_process(grasp.hand.name, first.address))

        return judge(label, simulation.simulate(plant, driver, follow, END, on_step=watch), commands[1:])


class _RecordingDriver:
    """Driver that records its commands."""

    def __init__(self, driver: StreamController, commands: list[RemoteCommand]) -> None:
        self.driver, self.commands = driver, commands

    def step(self, state: object, desired: BodyMotion, external: object = None) -> RemoteCommand:
        self.commands.append(self.driver.step(state, desired, external))  # type: ignore[arg-type]
        return self.commands[-1]


def judge(label: str, run: Recording, commands: list[RemoteCommand]) -> Row:
    """Return the figures of one run.

    Args:
        label: hand and travel.
        run: the simulation.
        commands: one command for each step.
    """
    dt = run.t[1]
    killed = round(LOSS / dt)
    late = np.array([command.late for command in commands])
    lost = killed + int(late[killed:].argmax())
    restored = lost + int(np.argmin(late[lost:]))  # first step with a command of the new server
    resuming = np.array([command.resuming for command in commands])
    recovered = restored + int(np.argmin(resuming[restored:]))
    displacement = run.p_HO[killed:restored] - run.p_HO[killed]
    changes = np.abs(np.diff(run.tau_command, axis=0)).max(axis=1)
    return Row(
        label=label,
        outage=(restored - lost) * dt,
        moved=float(np.linalg.norm(displacement, axis=1).max()),
        creep=float(np.linalg.norm(displacement[-1] - displacement[len(displacement) // 2])),
        margin=float(run.slip_margin[killed:recovered].min()),
        steps_without_contact=int((run.touching.min(axis=1) == 0.0).sum()),
        max_torque_step=float(changes[lost - 1 : recovered].max()),
        recovery=(recovered - restored) * dt,
        error=float(np.linalg.norm(run.position_error[-100:], axis=1).max()),
    )


if __name__ == "__main__":
    main()
