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

from graspforce import arrays, fields, friction, tracking
from graspforce.control import ControlSettings, ObjectController
from graspforce.errors import InvalidInput
from graspforce.hold import Hold
from graspforce.options import HoldWish, new_file, new_folder
from graspforce.planning import Plan, Progress, Refusal, Task, save
from graspforce.planning.export import ENDINGS
from graspforce.planning.limits import contacts_padded, limits
from graspforce.planning.move import FreeMove, Move, PathMove
from graspforce.planning.progress import CHECK, EQUATIONS, PATH, REACH, SEARCH
from graspforce.planning.refusal import STOPPED, UNSOLVED
from graspforce.service import Client

FOUND, MISSED, REFUSED = 0, 1, 2  # exit codes
_ARRIVED, _ALIGNED = 1e-3, np.radians(1.0)  # m, rad: what counts as having arrived
_AFTER = 0.1  # s: how long the executed move is watched at its goal
_METHODS: dict[str, type[PathMove | FreeMove]] = {"path": PathMove, "free": FreeMove}
_STAGES = {
    REACH: "Following the path with the fingers",
    PATH: "Looking for the fastest motion along it",
    EQUATIONS: "Writing down the whole move",
    SEARCH: "Looking for a faster way",
    CHECK: "Checking between the knots",
}
_BRIEF = 0.01  # of the time: what limits for less is not worth a line
_SAMPLES = 400  # instants at which limits are looked at
_SAMPLE = 1e-3  # s, between rows of a saved trajectory


@dataclass(frozen=True, slots=True)
class Wish:
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

    hold: HoldWish
    to: tuple[float, ...]
    turn: tuple[float, ...]
    method: str
    intervals: int | None
    budget: float
    slip_margin: float
    reserve: float

    def __post_init__(self) -> None:
        fields.choice(self.method, "method", tuple(_METHODS))
        arrays.array(self.to, "to", (3,))
        if np.linalg.norm(arrays.array(self.turn, "turn", (3,))) >= np.pi:
            raise InvalidInput("turn", self.turn, f"shorter than half a turn, {np.pi:.4f} rad")
        arrays.number(self.budget, "budget", minimum=0.0)
        arrays.number(self.slip_margin, "margin", minimum=0.0)
        tracking.kept_back(self.reserve)
        if not any(self.to + self.turn):
            raise InvalidInput("to", self.to, "not zero where the turn is zero too")


@dataclass(frozen=True, slots=True)
class Output:
    """What to do with the plan; nothing where None or False.

    Raises:
        InvalidInput: a file of a kind that plans are not written to, or where none can be; said before planning, not after.
    """

    save: Path | None
    plots: Path | None
    execute: bool

    def __post_init__(self) -> None:
        if self.save is not None:
            fields.choice(self.save.suffix, "the end of --save", ENDINGS)
        new_file(self.save, "--save")
        new_folder(self.plots, "--plots")


def run(wish: Wish, output: Output, console: Console, connect: str | None = None) -> int:
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
    settings = ControlSettings(slip_margin=wish.slip_margin, gravity_H=wish.hold.gravity_H)
    hold = wish.hold.find(console)
    task = tracking.task(hold, settings, wish.reserve)
    plan = _planned(_move(task, hold, wish), wish.budget, connect, console)
    if isinstance(plan, Refusal):
        return _refuse(plan, console)
    with console.status("Rehearsing it with contacts that roll"):
        pace = tracking.paced(plan, hold, settings)
    console.print(table(plan, hold, pace))
    if output.save is not None:
        output.save.parent.mkdir(parents=True, exist_ok=True)
        save(plan, output.save, _SAMPLE)
        console.print(f"The plan: [bold]{output.save}[/]", soft_wrap=True)
    if output.plots is not None:
        from graspforce.planning import plots

        for file in plots.draw(plan, output.plots):
            console.print(f"Plot: [bold]{file}[/]", soft_wrap=True)
    if not output.execute:
        return FOUND
    return _refuse(pace, console) if isinstance(pace, Refusal) else _execute(pace, hold, settings, output, console)


def _move(task: Task, hold: Hold, wish: Wish) -> Move:
    """The move from where the object is held to where it is wanted."""
    R_goal = Rotation.from_rotvec(wish.turn).as_matrix() @ hold.R_HO
    p_HO = np.array([hold.p_HO, hold.p_HO + arrays.array(wish.to, "to", (3,))])
    kind = _METHODS[wish.method]
    intervals: dict[str, Any] = {} if wish.intervals is None else {"intervals": wish.intervals}
    return kind(task, p_HO, np.array([hold.R_HO, R_goal]), q_start=hold.q, **intervals)


def _planned(move: Move, budget: float, connect: str | None, console: Console) -> Plan | Refusal:
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
                return move.plan(budget=budget, watch=watch)
            with Client(connect) as client:
                return client.plan(move, budget=budget, progress=watch)
        finally:
            if main:
                signal.signal(signal.SIGINT, before)


def _refuse(refusal: Refusal, console: Console) -> int:
    if refusal.kind in (UNSOLVED, STOPPED):
        console.print(f"[yellow]No plan:[/] {refusal.reason}")
        return MISSED
    console.print(f"[red]This move cannot be:[/] {refusal.reason}")
    return REFUSED


def table(plan: Plan, hold: Hold, pace: tracking.Paced | Refusal) -> Table:
    """The figures of a plan.

    Args:
        plan: the plan.
        hold: where it begins, with the hand's and the contacts' own limits.
        pace: what the rehearsal said.
    """
    shown = Table("figure", "value", title=f"{hold.hand.name}: the fastest move")
    so_far = ", the best when the search was stopped" if plan.stopped else ""
    shown.add_row("duration", f"{1e3 * plan.duration:.2f} ms{so_far}")
    times = np.linspace(0.0, plan.duration, _SAMPLES)
    reached = [limit for limit in limits(plan, times) if limit.active.mean() >= _BRIEF]
    for i, limit in enumerate(reached[:6]):
        spans = ", ".join(f"{1e3 * a:.1f}–{1e3 * b:.1f}" for a, b in limit.spans(times)[:4])
        more = ", …" if len(limit.spans(times)) > 4 else ""
        when = f"{100 * limit.active.mean():.0f} % of the time: {spans}{more} ms"
        shown.add_row("what limits it" if i == 0 else "", f"{limit} ({when})")
    at = plan.at(times)
    share = np.abs(at.tau) / hold.hand.torque_upper
    busiest = hold.hand.joints[int(share.max(axis=0).argmax())].name
    shown.add_row("busiest motor", f"{busiest}, at {100.0 * share.max():.0f} % of its limit")
    margins = friction.slip_margin(contacts_padded(plan, at.f), hold.contacts.mu, hold.contacts.gamma)
    loosest = hold.fingers[int(margins.min(axis=0).argmin())]
    shown.add_row("least slip margin", f"{margins.min():.3f} N, of {loosest}")
    words = "none" if plan.check.excess <= 0.0 else f"{100.0 * plan.check.excess:.3f} % of a limit"
    shown.add_row("beyond limits between knots", f"{words} (looked at {plan.check.samples} instants)")
    if isinstance(pace, Refusal):
        shown.add_row("with contacts that roll", f"[yellow]it cannot be followed: {pace.reason}[/]")
    else:
        slower = "at its own pace" if pace.slowed == 1.0 else f"{pace.slowed:.2f} times slower"
        shown.add_row("with contacts that roll", f"it can be followed {slower}, softened: {1e3 * pace.duration:.1f} ms")
    effort = plan.effort
    seconds = effort.path + effort.dynamics + effort.building + effort.solver + effort.check
    shown.add_row("planned in", f"{1e3 * seconds:.0f} ms")
    return shown


def _execute(pace: tracking.Paced, hold: Hold, settings: ControlSettings, output: Output, console: Console) -> int:
    """Follow it in MuJoCo, and say where the object came to rest."""
    from graspforce import closed_loop, simulation

    plant = simulation.Plant(simulation.build(hold, gravity_H=settings.gravity_H))
    with closed_loop.progress(pace.duration + _AFTER, console) as watch:
        recording = simulation.simulate(
            plant, ObjectController(hold, settings), pace.reference(), pace.duration + _AFTER, on_step=watch
        )
    console.print(closed_loop.summary(recording))
    if output.plots is not None:
        from graspforce.simulation import plots

        for file in plots.draw(recording, output.plots / "executed"):
            console.print(f"Plot: [bold]{file}[/]", soft_wrap=True)
    got = simulation.figures(recording)
    off = float(np.linalg.norm(recording.error[-1]))
    turned = float(np.linalg.norm(recording.turn_error[-1]))
    console.print(f"The object comes to rest {1e3 * off:.4f} mm and {np.degrees(turned):.4f}° from its goal.")
    kept = got.lost == 0 and got.slid == 0
    if not kept:
        console.print(f"[yellow]It slipped: a fingertip was off in {got.lost} steps, and slid in {got.slid}.[/]")
    return FOUND if kept and off <= _ARRIVED and turned <= _ALIGNED else MISSED
