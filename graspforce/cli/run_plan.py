"""The command ``graspforce plan``: find a grasp, plan its fastest move, show it, and execute it in MuJoCo if asked."""

from __future__ import annotations

import signal
import threading
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar
from rich.table import Table
from scipy.spatial.transform import Rotation

from graspforce.cli.console import ERROR, INFEASIBLE, SUCCESS
from graspforce.cli.film_format import FilmFormat
from graspforce.cli.json_output import put_result
from graspforce.cli.options import GraspOptions, RunFiles, parse_vector
from graspforce.cli.output_files import check_new_file, check_new_folder
from graspforce.cli.run_finger_plan import FingerPlanOptions, print_plan
from graspforce.cli.scene_options import collision_settings, parse_table, table_under
from graspforce.contact import friction
from graspforce.control import ControlSettings
from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import GraspSearchOptions
from graspforce.hand.hand import Hand
from graspforce.planning import FreeMove, GraspTask, Move, PathMove, Plan, PlanFailure, Progress, save, tracking
from graspforce.planning.acceleration_limits import UNLIMITED, AccelerationLimits
from graspforce.planning.failure import STOPPED, UNSOLVED
from graspforce.planning.limit_usage import limit_usage
from graspforce.planning.plan_files import FILE_SUFFIXES
from graspforce.planning.progress import CHECK, EQUATIONS, JOINT_PATH, PATH, SEARCH
from graspforce.service import Client

_METHODS, _VIEWS = ("path", "free"), ("browser",)
_STAGES = {
    JOINT_PATH: "Computing the joint path",
    PATH: "Optimising along the path",
    EQUATIONS: "Building the program",
    SEARCH: "Optimising the move",
    CHECK: "Checking between knots",
}
_LIMIT_OPTIONS = {
    "linear": "acceleration",
    "angular": "acceleration",
    "joints": "joint-acceleration",
    "linear_jerk": "jerk",
    "angular_jerk": "jerk",
    "joint_jerk": "joint-jerk",
}
_MIN_ACTIVE_FRACTION = 0.01  # of the time: limits active for less are not listed
_SAMPLES = 400  # instants at which limits are evaluated
_EXPORT_PERIOD = 1e-3  # s, between rows of a saved trajectory


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """Options of a plan.

    Args:
        grasp: the grasp that the move starts from.
        to: translation of the object in H, m.
        turn: rotation vector in H, shorter than half a turn, rad.
        method: "path", along a straight line; or "free", with the path optimised.
        intervals: number of intervals (default: 100; 40 for the free method).
        budget: planning time, s; then the best plan so far is used.
        slip_margin: slip margin of planner and controller, N.
        reserve: fraction of motor torque reserved for feedback.
        via: for each via pose the translation, m, and the rotation vector, rad, from the start, in H.
        limits: limits of accelerations.
        clearance: least distance of links, object and obstacles, m.
        obstacles: bodies at rest, as for `parse_obstacle`.
        table: direction in O away from a table on which the object stands; None without a table.

    Raises:
        InvalidInput: an unknown method, a move of zero length, a rotation of half a turn or more, via poses with the free
            method, or numbers out of range.
    """

    grasp: GraspOptions
    to: tuple[float, ...]
    turn: tuple[float, ...]
    method: str
    intervals: int | None
    budget: float
    slip_margin: float
    reserve: float
    via: tuple[tuple[float, ...], ...] = ()
    limits: AccelerationLimits = UNLIMITED
    clearance: float = 0.0
    obstacles: tuple[str, ...] = ()
    table: str | None = None

    def __post_init__(self) -> None:
        fields.check_choice(self.method, "method", _METHODS)
        arrays.check_array(self.to, "to", (3,))
        if np.linalg.norm(arrays.check_array(self.turn, "turn", (3,))) >= np.pi:
            raise InvalidInput("turn", self.turn, f"shorter than half a turn, {np.pi:.4f} rad")
        arrays.check_number(self.budget, "budget", minimum=0.0)
        arrays.check_number(self.slip_margin, "slip-margin", minimum=0.0)
        tracking.check_torque_reserve(self.reserve, "reserve")
        if self.via and self.method != "path":
            raise InvalidInput(
                "via", self.via[0], "given with --method path, which follows a path; the free method chooses its own"
            )
        for pose in self.via:
            if np.linalg.norm(arrays.check_array(pose, "via", (6,))[3:]) >= np.pi:
                raise InvalidInput("via", pose, f"a rotation vector shorter than half a turn, {np.pi:.4f} rad")
        if not any(self.to + self.turn) and not self.via:
            raise InvalidInput("to", self.to, "different from zero, or give --turn or --via")
        collision_settings(self.clearance, self.obstacles)
        parse_table(self.table)

    def task(self, grasp: Grasp, settings: ControlSettings) -> GraspTask:
        """Return the task of a grasp, with the bodies around it.

        Args:
            grasp: the grasp.
            settings: settings of the controller.
        """
        around, up_O = collision_settings(self.clearance, self.obstacles), parse_table(self.table)
        if up_O is not None:
            around = replace(around, obstacles=(*around.obstacles, table_under(grasp, up_O)))
        task = tracking.object_task(grasp, settings, self.reserve)
        return replace(task, acceleration_limits=self.limits, collisions=around)


@dataclass(frozen=True, slots=True)
class PlanOutput:
    """Files to write and whether to execute the plan; None and False skip an output. With `force`, existing files are replaced.

    Raises:
        InvalidInput: a file type that plans have not, a path that is not writable, or a film without an execution; raised
            before planning.
    """

    save: Path | None
    plots: Path | None
    execute: bool
    video: Path | None = None
    frames: Path | None = None
    force: bool = True
    film: FilmFormat = field(default_factory=FilmFormat)
    view: str | None = None

    def __post_init__(self) -> None:
        if self.view is not None:
            fields.check_choice(self.view, "--view", _VIEWS)
        for path, option in ((self.video, "--video"), (self.frames, "--frames")):
            if path is not None and not self.execute:
                raise InvalidInput(option, str(path), "given with --execute only")
        check_new_file(self.video, "--video", self.force)
        check_new_folder(self.frames, "--frames")
        if self.save is not None:
            fields.check_choice(self.save.suffix, "the end of --save", FILE_SUFFIXES)
        check_new_file(self.save, "--save", self.force)
        check_new_folder(self.plots, "--plots")


def parse_via(text: str) -> tuple[float, ...]:
    """Return the six numbers of a via pose: translation, m, and rotation vector, rad.

    Args:
        text: three or six numbers separated by commas; three stand for no rotation.

    Raises:
        InvalidInput: another count, or not numbers.
    """
    if text.count(",") == 2:
        return (*parse_vector(text, "via"), 0.0, 0.0, 0.0)
    return parse_vector(text, "via", 6)


def parse_limits(
    acceleration: str | None, joint_acceleration: float | None, jerk: str | None = None, joint_jerk: float | None = None
) -> AccelerationLimits:
    """Return the limits of accelerations and jerk of four options; None for no limit.

    Args:
        acceleration: one number or two separated by commas: linear, m/s², and angular, rad/s², of the object.
        joint_acceleration: of each joint, rad/s².
        jerk: one number or two separated by commas: linear, m/s³, and angular, rad/s³, of the object.
        joint_jerk: of each joint, rad/s³.

    Raises:
        InvalidInput: not numbers, or out of range.
    """
    options = {"joints": joint_acceleration, "joint_jerk": joint_jerk}
    given = {name: value for name, value in options.items() if value is not None}
    for text, option, names in (
        (acceleration, "acceleration", ("linear", "angular")),
        (jerk, "jerk", ("linear_jerk", "angular_jerk")),
    ):
        if text is not None:
            given |= dict(zip(names, parse_vector(text, option, 1 + min(text.count(","), 1)), strict=False))
    try:
        return AccelerationLimits(**given)
    except InvalidInput as error:
        raise error.with_field(_LIMIT_OPTIONS[error.field]) from None


def run(options: PlanOptions, output: PlanOutput, console: Console, connect: str | None = None) -> int:
    """Find a grasp, plan, print the plan, and execute it if asked.

    Args:
        options: what to plan.
        output: files to write, and whether to execute.
        console: where progress and results are printed.
        connect: Zenoh endpoint of a service that plans; None plans in this process.

    Returns:
        SUCCESS; INFEASIBLE if the move is infeasible; ERROR if no plan was found and none is excluded, or if the
        executed move slipped or missed its goal.

    Raises:
        InvalidInput: options that are not allowed.
        ServiceError: no service, or it does not serve the hand.
    """
    settings = ControlSettings(slip_margin=options.slip_margin, gravity_H=options.grasp.gravity_H)
    up_O = parse_table(options.table)
    grasp = options.grasp.search(console, None if up_O is None else GraspSearchOptions(up_O=up_O))
    plan = _make_plan(_move(options.task(grasp, settings), grasp, options), options.budget, connect, console)
    if isinstance(plan, PlanFailure):
        return _print_failure(plan, console)
    with console.status("Checking that the controller can track it"):
        pace = tracking.time_scale_plan(plan, grasp, settings)
    console.print(table(plan, grasp, pace))
    result = _record(plan, grasp, pace)
    _save(plan, output, console, grasp.hand)
    if not output.execute:
        put_result(console, result)
        if output.view is not None:
            _show_in_browser(plan, grasp, settings, console)
        return SUCCESS
    if isinstance(pace, PlanFailure):
        return _print_failure(pace, console)
    from graspforce.cli.execute_plan import execute

    files = RunFiles(output.video, output.frames, output.plots, film=output.film)
    is_executed = execute(pace, grasp, settings, files, console)
    put_result(console, {**result, "is_executed": is_executed})
    if output.view is not None:
        _show_in_browser(plan, grasp, settings, console)
    return SUCCESS if is_executed else ERROR


def run_fingers(
    options: FingerPlanOptions, output: PlanOutput, budget: float, console: Console, connect: str | None = None
) -> int:
    """Plan a move of fingers alone, print the plan, and write files.

    Args:
        options: what to plan.
        output: files to write.
        budget: planning time, s.
        console: where progress and results are printed.
        connect: Zenoh endpoint of a service that plans; None plans in this process.

    Returns:
        SUCCESS; INFEASIBLE if the move is infeasible; ERROR if no plan was found and none is excluded.

    Raises:
        InvalidInput: options that are not allowed, such as an execution.
        ServiceError: no service, or it does not serve the hand.
    """
    for option, value in (("--execute", output.execute or None), ("--view", output.view)):
        if value is not None:
            raise InvalidInput(option, value, "a move of an object, without --fingertips")
    arrays.check_number(budget, "budget", minimum=0.0)
    plan = _make_plan(options.move(), budget, connect, console)
    if isinstance(plan, PlanFailure):
        return _print_failure(plan, console)
    print_plan(plan, console)
    _save(plan, output, console)
    checked = {"excess_between_knots": plan.check.excess, "stopped": plan.stopped, "seconds": plan.statistics.seconds}
    put_result(console, {"hand": options.hand, "duration": plan.duration, **checked})
    return SUCCESS


def _show_in_browser(plan: Plan, grasp: Grasp, settings: ControlSettings, console: Console) -> None:
    """Show a plan in a web browser until Ctrl-C."""
    from graspforce.cli.run_view import show
    from graspforce.simulation import build_scene

    show(build_scene(grasp, gravity_H=settings.gravity_H), plan, console)


def _save(plan: Plan, output: PlanOutput, console: Console, hand: Hand | None = None) -> None:
    """Write the plan and its plots, with torques in % of the limits of a hand."""
    if output.save is not None:
        output.save.parent.mkdir(parents=True, exist_ok=True)
        save(plan, output.save, _EXPORT_PERIOD)
        console.print(f"Plan: [bold]{output.save}[/]", soft_wrap=True)
    if output.plots is not None:
        from graspforce.view import plan_plots

        for file in plan_plots.save_plots(plan, output.plots, hand):
            console.print(f"Plot: [bold]{file}[/]", soft_wrap=True)


def _record(plan: Plan, grasp: Grasp, pace: tracking.TimeScaledPlan | PlanFailure) -> dict[str, object]:
    """Return a plan for JSON, with the time scale at which the controller can track it."""
    is_trackable = not isinstance(pace, PlanFailure)
    return {
        "hand": grasp.hand.name,
        "duration": plan.duration,
        "is_trackable": is_trackable,
        "time_scale": None if isinstance(pace, PlanFailure) else pace.time_scale,
        "reason": pace.reason if isinstance(pace, PlanFailure) else "",
        "excess_between_knots": plan.check.excess,
        "stopped": plan.stopped,
        "seconds": plan.statistics.seconds,
    }


def _move(task: GraspTask, grasp: Grasp, options: PlanOptions) -> Move:
    """Return the move from the grasp through the via poses to the goal pose."""
    steps = np.array([np.zeros(6), *options.via, [*options.to, *options.turn]])
    p_HO, R_HO = grasp.p_HO + steps[:, :3], Rotation.from_rotvec(steps[:, 3:]).as_matrix() @ grasp.R_HO
    given: dict[str, Any] = {} if options.intervals is None else {"intervals": options.intervals}
    if options.method == "free":
        return FreeMove(task, p_HO, R_HO, q_start=grasp.q, **given)
    return PathMove(task, p_HO, R_HO, "spline" if options.via else "straight", q_start=grasp.q, **given)


def _make_plan(move: Move, budget: float, connect: str | None, console: Console) -> Plan | PlanFailure:
    """Plan here or in a service, with a progress bar. Ctrl-C uses the best plan so far; a second one ends the command."""
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
    put_result(console, {"duration": None, "kind": failure.kind, "reason": failure.reason})
    if failure.kind in (UNSOLVED, STOPPED):
        console.print(f"[yellow]No plan:[/] {failure.reason}")
        return ERROR
    console.print(f"[red]Move infeasible:[/] {failure.reason}")
    return INFEASIBLE


def table(plan: Plan, grasp: Grasp, pace: tracking.TimeScaledPlan | PlanFailure) -> Table:
    """Return the table of a plan: duration, active limits, margins and tracking.

    Args:
        plan: the plan.
        grasp: its grasp, with the limits of hand and contacts.
        pace: result of the tracking check.
    """
    shown = Table("figure", "value", title=f"{grasp.hand.name}: fastest move, {1e3 * plan.duration:.1f} ms")
    so_far = " (best when stopped)" if plan.stopped else ""
    shown.add_row("duration", f"{1e3 * plan.duration:.2f} ms{so_far}")
    times = np.linspace(0.0, plan.duration, _SAMPLES)
    reached = [limit for limit in limit_usage(plan, times) if limit.active.mean() >= _MIN_ACTIVE_FRACTION]
    for i, limit in enumerate(reached[:6]):
        spans = ", ".join(f"{1e3 * a:.1f}–{1e3 * b:.1f}" for a, b in limit.spans(times)[:4])
        more = ", …" if len(limit.spans(times)) > 4 else ""
        when = f"{100 * limit.active.mean():.0f} % of the time: {spans}{more} ms"
        shown.add_row("active limits" if i == 0 else "", f"{limit} ({when})")
    at = plan.at(times)
    share = np.abs(at.tau) / grasp.hand.torque_upper
    busiest = grasp.hand.joints[int(share.max(axis=0).argmax())].name
    shown.add_row("busiest motor", f"{busiest}, {100.0 * share.max():.0f} % of its limit")
    margins = friction.slip_margin(grasp.contacts.pad(at.f), grasp.contacts.mu, grasp.contacts.gamma)
    loosest = grasp.fingers[int(margins.min(axis=0).argmin())]
    shown.add_row("smallest slip margin", f"{margins.min():.3f} N, {loosest}")
    words = "none" if plan.check.excess <= 0.0 else f"{100.0 * plan.check.excess:.3f} % of a limit"
    shown.add_row("violation between knots", f"{words} ({plan.check.samples} instants checked)")
    if isinstance(pace, PlanFailure):
        shown.add_row("tracking", f"[yellow]not trackable: {pace.reason}[/]")
    else:
        slower = "" if pace.time_scale == 1.0 else f", slowed by {pace.time_scale:.2f}"
        shown.add_row("tracking", f"trackable with rolling contacts{slower}; smoothed duration {1e3 * pace.duration:.1f} ms")
    shown.add_row("planning time", f"{1e3 * plan.statistics.seconds:.0f} ms")
    return shown
