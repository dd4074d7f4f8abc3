"""What a held object does when the server is lost in mid-motion: python -m benchmarks.lost_server [--save FILE].

A ball of 50 g goes out and back once a second in MuJoCo, in real time, over 10 mm (dlr_hit2: 5 mm; with more its thumb comes to
its motors' limits even with a server). The controller runs in a service, whose process is killed where the ball is fastest and
started again a second later. Meanwhile the driver's watchdog holds: as by default, but for as long as a process may take to
start.
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

# A start may take no time at all, and the object is to stay in the hand for a second.
LOSS, RESTART, END = 1.25, 2.3, 7.0  # s: the server is killed, is started again, and the run ends
WATCHDOG = Watchdog(hold=END)


@dataclass(frozen=True, slots=True)
class Row:
    """What one loss did.

    Attributes:
        what: the hand, and how it holds.
        away: how long no command came, s.
        moved: how far the object went since the kill, m: as long as the last command is good it goes on, then it is braked.
        crept: how far in the last half of that, m.
        margin: the least friction that the plant's contacts had left, from the loss until commands are met, N.
        off: steps of the whole run in which a fingertip did not touch.
        change: the largest change of a joint's torque from one period to the next, from the loss until commands are met, N·m.
        back: how long it took, from the first command that came again, until commands were met, s.
        error: how far the object is from where it should be in the last tenth of a second, m.
    """

    label: str
    away: float
    moved: float
    creep: float
    margin: float
    steps_without_contact: int
    max_torque_step: float
    back: float
    error: float

    @property
    def met(self) -> bool:
        """The object stays in the hand for a second, and the torque keeps its bound."""
        bound = WATCHDOG.step * (1.0 + 1e-9)  # rounding
        return (
            self.away >= 1.0
            and self.steps_without_contact == 0
            and self.margin > 0.0
            and self.max_torque_step <= bound
            and self.error < 1e-4
        )


# What holds the ball, how gravity pulls, and how far it goes upwards or, between planar fingers, the most upward way they have.
GRASPS: dict[str, Callable[[], tuple[Grasp, Array, float]]] = {
    "allegro_right, three fingers, 10 mm": lambda: (three_finger_grasp(), PALM_UP, 0.01),
    "four_finger, 10 mm": lambda: (_find_grasp("four_finger"), EARTH, 0.01),
    "anthropomorphic15, 5 mm": lambda: (_find_grasp("anthropomorphic15"), EARTH, 0.005),
    "dlr_hit2, 5 mm": lambda: (_find_grasp("dlr_hit2"), EARTH, 0.005),
}


def _find_grasp(name: str) -> Grasp:
    return find_grasp(Hand.load(name), Body.solid(Sphere(0.03), 0.05), friction=0.7, gravity_H=EARTH)


def main() -> None:
    """Measure and show."""
    options = report_page.parser("lost_server", __doc__).parse_args()
    bound = f"largest torque step (bound {WATCHDOG.step:g} N·m)"
    heads = ["hand", "no command for", "ball moved", "in its last half", "least slip margin", "steps off the ball"]
    heads += [bound, "commands met again after", "off its path at the end", "held"]
    lines: list[list[str]] = []
    for label, grasp in GRASPS.items():
        row = run_with_server_loss(label, *grasp())
        cells = [
            row.label,
            f"{row.away:.3f} s",
            f"{1e3 * row.moved:.3f} mm",
            f"{1e6 * row.creep:.2f} µm",
            f"{row.margin:.3f} N",
        ]
        cells += [
            str(row.steps_without_contact),
            f"{row.max_torque_step:.4f} N·m",
            f"{row.back:.3f} s",
            f"{1e3 * row.error:.3f} mm",
        ]
        cells += ["yes" if row.met else "no"]
        lines.append(cells)
    report_page.show("The server is killed in mid-motion and returns", heads, lines, width=180)
    if options.save:
        facts = report_page.facts(f"MuJoCo {mujoco.__version__}")
        report_page.save(options.save, "A lost server", __doc__, facts, report_page.table(heads, lines))


def run_with_server_loss(label: str, grasp: Grasp, gravity_H: Array, travel: float) -> Row:
    """Run, kill, start again, and judge."""
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
    """A driver whose commands are kept."""

    def __init__(self, driver: StreamController, commands: list[RemoteCommand]) -> None:
        self.driver, self.commands = driver, commands

    def step(self, state: object, desired: BodyMotion, external: object = None) -> RemoteCommand:
        self.commands.append(self.driver.step(state, desired, external))  # type: ignore[arg-type]
        return self.commands[-1]


def judge(label: str, run: Recording, commands: list[RemoteCommand]) -> Row:
    """Return the figures of one run, with one command for each step."""
    dt = run.t[1]
    killed = round(LOSS / dt)
    late = np.array([command.late for command in commands])
    first = killed + int(late[killed:].argmax())
    back = first + int(np.argmin(late[first:]))  # the first step that a command of the new server serves
    resuming = np.array([command.resuming for command in commands])
    met = back + int(np.argmin(resuming[back:]))
    away = run.p_HO[killed:back] - run.p_HO[killed]
    changes = np.abs(np.diff(run.tau_command, axis=0)).max(axis=1)
    return Row(
        label=label,
        away=(back - first) * dt,
        moved=float(np.linalg.norm(away, axis=1).max()),
        creep=float(np.linalg.norm(away[-1] - away[len(away) // 2])),
        margin=float(run.slip_margin[killed:met].min()),
        steps_without_contact=int((run.touching.min(axis=1) == 0.0).sum()),
        max_torque_step=float(changes[first - 1 : met].max()),
        back=(met - back) * dt,
        error=float(np.linalg.norm(run.position_error[-100:], axis=1).max()),
    )


if __name__ == "__main__":
    main()
