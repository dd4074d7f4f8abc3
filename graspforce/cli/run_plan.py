"""The command ``graspforce plan``: the fastest move of what a hand holds, as a table, a file and plots; executed in MuJoCo.

It finds a hold, plans, rehearses with contacts that roll, and shows; with ``--execute`` a controller follows the plan.
"""

from __future__ import annotations

import signal
import threading
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar
from rich.table import Table
from scipy.spatial.transform import Rotation

from graspforce.cli.options import GraspOptions, check_new_file, check_new_folder
from graspforce.contact import friction
from graspforce.control import ControlSettings, ObjectController
from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.planning import Plan, PlanFailure, Progress, Task, save, tracking
from graspforce.planning.failure import STOPPED, UNSOLVED
from graspforce.planning.limit_usage import limit_usage
from graspforce.planning.moves import FreeMove, Move, PathMove
from graspforce.planning.plan_files import FILE_SUFFIXES
from graspforce.planning.progress import CHECK, EQUATIONS, JOINT_PATH, PATH, SEARCH
from graspforce.service import Client

EXIT_OK, EXIT_ERROR, EXIT_INFEASIBLE = 0, 1, 2  # exit codes
_POSITION_TOLERANCE, _ORIENTATION_TOLERANCE = 1e-3, np.radians(1.0)  # m, rad: what counts as having arrived
_GOAL_TIME = 0.1  # s: how long the executed move is watched at its goal
_METHODS: dict[str, type[PathMove | FreeMove]] = {"path": PathMove, "free": FreeMove}
_STAGES = {
    JOINT_PATH: "Following the path with the fingers",
    PATH: "Looking for the fastest motion along it",
    EQUATIONS: "Writing down the whole move",
    SEARCH: "Looking for a faster way",
    CHECK: "Checking between the knots",
}
_MIN_ACTIVE_FRACTION = 0.01  # of the time: what limits for less is not worth a line
_SAMPLES = 400  # instants at which limits are looked at
_EXPORT_PERIOD = 1e-3  # s, between rows of a saved trajectory


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """What to plan; as the command's options say it.

    Args:
        hold: where the move begins.
        to: how far, in H, m.
        turn: rotation vector in H, of less than half a turn, rad.
        method: path, along the straight line; or free, whichever way is faster.
        intervals: between the plan's knots; by default 100 along a path and 40 of a free move.
        budget: s that planning may take; the best plan so far is taken then.
        slip_margin: N, that planner and controller keep.
        reserve: the part of motor torque that is left to the controller.

    Raises:
        InvalidInput: another method, a move that goes nowhere or half round, or numbers that cannot be.
    """

    grasp: GraspOptions
    to: tuple[float, ...]
    turn: tuple[float, ...]
    method: str
    intervals: int | None
    budget: float
    slip_margin: float
    reserve: float

    def __post_init__(self) -> None:
        fields.check_choice(self.method, "method", tuple(_METHODS))
        arrays.check_array(self.to, "to", (3,))
        if np.linalg.norm(arrays.check_array(self.turn, "turn", (3,))) >= np.pi:
            raise InvalidInput("turn", self.turn, f"shorter than half a turn, {np.pi:.4f} rad")
        arrays.check_number(self.budget, "budget", minimum=0.0)
        arrays.check_number(self.slip_margin, "margin", minimum=0.0)
        tracking.check_torque_reserve(self.reserve)
        if not any(self.to + self.turn):
            raise InvalidInput("to", self.to, "not zero where the turn is zero too")


@dataclass(frozen=True, slots=True)
class PlanOutput:
    """What to do with the plan; nothing where None or False.

    Raises:
        InvalidInput: a file of a kind that plans are not written to, or where none can be; said before planning, not after.
    """

    save: Path | None
    plots: Path | None
    execute: bool

    def __post_init__(self) -> None:
        if self.save is not None:
            fields.check_choice(self.save.suffix, "the end of --save", FILE_SUFFIXES)
        check_new_file(self.save, "--save")
        check_new_folder(self.plots, "--plots")


def run(options: PlanOptions, output: PlanOutput, console: Console, connect: str | None = None) -> int:
    """Find a hold, plan, show, execute.

    Args:
        wish: what to plan.
        output: what to do with the plan.
        console: where the progress and the figures go.
        connect: the Zenoh endpoint of a service that plans; None to plan here.

    Returns:
        FOUND; REFUSED where the move cannot be, with the reason shown; MISSED where no plan was found but nothing proves that
        there is none, or where the executed move slipped or missed its goal.

    Raises:
        InvalidInput: a wish that cannot be.
        ServiceError: no service, or it does not serve the hand.
    """
    settings = ControlSettings(slip_margin=options.slip_margin, gravity_H=options.grasp.gravity_H)
    grasp = options.grasp.search(console)
    task = tracking.object_task(grasp, settings, options.reserve)
    plan = _make_plan(_move(task, grasp, options), options.budget, connect, console)
    if isinstance(plan, PlanFailure):
        return _print_failure(plan, console)
    with console.status("Rehearsing it with contacts that roll"):
        pace = tracking.time_scale_plan(plan, grasp, settings)
    console.print(table(plan, grasp, pace))
    if output.save is not None:
        output.save.parent.mkdir(parents=True, exist_ok=True)
        save(plan, output.save, _EXPORT_PERIOD)
        console.print(f"The plan: [bold]{output.save}[/]", soft_wrap=True)
    if output.plots is not None:
        from graspforce.view import plan_plots

        for file in plan_plots.save_plots(plan, output.plots):
            console.print(f"Plot: [bold]{file}[/]", soft_wrap=True)
    if not output.execute:
        return EXIT_OK
    return _print_failure(pace, console) if isinstance(pace, PlanFailure) else _execute(pace, grasp, settings, output, console)


def _move(task: Task, grasp: Grasp, options: PlanOptions) -> Move:
    """The move from where the object is held to where it is wanted."""
    R_goal = Rotation.from_rotvec(options.turn).as_matrix() @ grasp.R_HO
    p_HO = np.array([grasp.p_HO, grasp.p_HO + arrays.check_array(options.to, "to", (3,))])
    kind = _METHODS[options.method]
    intervals: dict[str, Any] = {} if options.intervals is None else {"intervals": options.intervals}
    return kind(task, p_HO, np.array([grasp.R_HO, R_goal]), q_start=grasp.q, **intervals)


def _make_plan(move: Move, budget: float, connect: str | None, console: Console) -> Plan | PlanFailure:
    """Plan it here or by a service, behind a bar; Ctrl-C takes the best plan so far, a second one ends everything."""
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[best]}"), TimeElapsedColumn())
    stop = False

    def on_signal(number: int, frame: FrameType | None) -> None:
        nonlocal stop
        if stop:
            raise KeyboardInterrupt
        stop = True

    with Bar(*columns, console=console, transient=True) as bar:
        row = bar.add_task("Planning", total=1.0, best="")

        def watch(now: Progress) -> bool:
            words = _STAGES[now.stage] + (f", iteration {now.iteration}" if now.iteration else "")
            best = "" if now.best is None else f"best so far {1e3 * now.best:.2f} ms"
            bar.update(row, completed=now.fraction, description=words, best=best)
            return not stop

        main = threading.current_thread() is threading.main_thread()
        before = signal.signal(signal.SIGINT, on_signal) if main else None
        try:
            if connect is None:
                return move.plan(budget=budget, callback=watch)
            with Client(connect) as client:
                return client.plan(move, budget=budget, callback=watch)
        finally:
            if main:
                signal.signal(signal.SIGINT, before)


def _print_failure(failure: PlanFailure, console: Console) -> int:
    if failure.kind in (UNSOLVED, STOPPED):
        console.print(f"[yellow]No plan:[/] {failure.reason}")
        return EXIT_ERROR
    console.print(f"[red]This move cannot be:[/] {failure.reason}")
    return EXIT_INFEASIBLE


def table(plan: Plan, grasp: Grasp, pace: tracking.TimeScaledPlan | PlanFailure) -> Table:
    """The figures of a plan.

    Args:
        plan: the plan.
        hold: where it begins, with the hand's and the contacts' own limits.
        pace: what the rehearsal said.
    """
    shown = Table("figure", "value", title=f"{grasp.hand.name}: the fastest move")
    so_far = ", the best when the search was stopped" if plan.stopped else ""
    shown.add_row("duration", f"{1e3 * plan.duration:.2f} ms{so_far}")
    times = np.linspace(0.0, plan.duration, _SAMPLES)
    reached = [limit for limit in limit_usage(plan, times) if limit.active.mean() >= _MIN_ACTIVE_FRACTION]
    for i, limit in enumerate(reached[:6]):
        spans = ", ".join(f"{1e3 * a:.1f}–{1e3 * b:.1f}" for a, b in limit.spans(times)[:4])
        more = ", …" if len(limit.spans(times)) > 4 else ""
        when = f"{100 * limit.active.mean():.0f} % of the time: {spans}{more} ms"
        shown.add_row("what limits it" if i == 0 else "", f"{limit} ({when})")
    at = plan.at(times)
    share = np.abs(at.tau) / grasp.hand.torque_upper
    busiest = grasp.hand.joints[int(share.max(axis=0).argmax())].name
    shown.add_row("busiest motor", f"{busiest}, at {100.0 * share.max():.0f} % of its limit")
    margins = friction.slip_margin(grasp.contacts.pad(at.f), grasp.contacts.mu, grasp.contacts.gamma)
    loosest = grasp.fingers[int(margins.min(axis=0).argmin())]
    shown.add_row("least slip margin", f"{margins.min():.3f} N, of {loosest}")
    words = "none" if plan.check.excess <= 0.0 else f"{100.0 * plan.check.excess:.3f} % of a limit"
    shown.add_row("beyond limits between knots", f"{words} (looked at {plan.check.samples} instants)")
    if isinstance(pace, PlanFailure):
        shown.add_row("with contacts that roll", f"[yellow]it cannot be followed: {pace.reason}[/]")
    else:
        slower = "at its own pace" if pace.time_scale == 1.0 else f"{pace.time_scale:.2f} times slower"
        shown.add_row("with contacts that roll", f"it can be followed {slower}, softened: {1e3 * pace.duration:.1f} ms")
    statistics = plan.statistics
    seconds = statistics.path + statistics.dynamics + statistics.building + statistics.solver + statistics.check
    shown.add_row("planned in", f"{1e3 * seconds:.0f} ms")
    return shown


def _execute(
    pace: tracking.TimeScaledPlan, grasp: Grasp, settings: ControlSettings, output: PlanOutput, console: Console
) -> int:
    """Follow it in MuJoCo, and say where the object came to rest."""
    from graspforce import simulation
    from graspforce.cli import run_simulation, step_callbacks

    plant = simulation.Plant(simulation.build_scene(grasp, gravity_H=settings.gravity_H))
    with step_callbacks.progress_bar(pace.duration + _GOAL_TIME, console) as watch:
        recording = simulation.simulate(
            plant, ObjectController(grasp, settings), pace.reference(), pace.duration + _GOAL_TIME, on_step=watch
        )
    console.print(run_simulation.summary_table(recording))
    if output.plots is not None:
        from graspforce.simulation import plots

        for file in plots.save_plots(recording, output.plots / "executed"):
            console.print(f"Plot: [bold]{file}[/]", soft_wrap=True)
    metrics = simulation.compute_metrics(recording)
    off = float(np.linalg.norm(recording.error[-1]))
    turned = float(np.linalg.norm(recording.orientation_error[-1]))
    console.print(f"The object comes to rest {1e3 * off:.4f} mm and {np.degrees(turned):.4f}° from its goal.")
    kept = metrics.lost_contact_steps == 0 and metrics.slip_steps == 0
    if not kept:
        console.print(
            f"[yellow]It slipped: a fingertip was off in {metrics.lost_contact_steps} steps, and slid in {metrics.slip_steps}.[/]"
        )
    return EXIT_OK if kept and off <= _POSITION_TOLERANCE and turned <= _ORIENTATION_TOLERANCE else EXIT_ERROR
