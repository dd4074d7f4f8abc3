"""Execution of minimum-time moves in MuJoCo: python -m benchmarks.planned_moves [--free] [--moves N] [--save FILE].

Three hands hold a ball of 50 g and 30 mm radius, μ = 0.7, palm up, in the grasp that the grasp search finds. Random seeded
moves go 5 to 20 mm in any direction and turn up to 20° about any axis. Moves that a finger cannot reach, or only near a
singular posture, are unreachable.

Each other move is planned with rolling contacts along the straight line, or with --free along the faster of that line and a
free path. Plans keep a slip margin of 1 N, and reserve 1/10 of friction and of motor torque and 1/30 of joint speed. They are
checked at 640 instants between knots. A simulation of the control law then scales a plan in time until the controller can
track it. The reference is smoothed over a few milliseconds and executed in MuJoCo with perfect measurements.

Arrived: within 1 mm and 1° of the goal for 0.1 s after the end of the move, without slip. Slip: a fingertip without contact, or
without slip margin, in any step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from rich.progress import Progress, SpinnerColumn, TextColumn
from scipy.spatial.transform import Rotation

from benchmarks import report_page
from graspforce import Hand, simulation
from graspforce.control import ControlSettings, ObjectController
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import find_grasp
from graspforce.planning import Plan, StraightPath, plan_along, plan_free, tracking
from graspforce.planning.check import SAMPLES_PER_INTERVAL, check_at_times, times_between
from graspforce.planning.failure import SINGULAR, UNREACHABLE
from graspforce.planning.settings import PlanSettings

HANDS = {
    "four_finger": ("finger_1", "finger_2", "finger_3"),
    "dlr_hit2": ("thumb", "index", "little"),
    "allegro_right": ("index", "ring", "thumb"),
}
SETTINGS = ControlSettings(slip_margin=1.0)
INTERVALS = 100
DRAWS = 400  # maximum number of random moves for each hand
SETTLING_TIME = 0.1  # s
_INSTANTS = 20 * SAMPLES_PER_INTERVAL  # instants between knots, 20 times as many as in the planner's own check


@dataclass(frozen=True, slots=True)
class Row:
    """Outcome of one move. Figures that do not exist are NaN.

    Attributes:
        hand: name of the hand.
        millimetres: travel of the object, mm.
        degrees: rotation of the object, °.
        failure: reason why the move was not planned or executed, or slipped; empty otherwise.
        duration: planned duration, s.
        excess: largest excess over a limit between knots, relative to the limit.
        time_scale: time scale at which the controller can track the plan.
        duration_ratio: executed over planned duration; includes smoothing.
        position_error: largest position error after the move, mm.
        orientation_error: largest orientation error after the move, °.
        lost_contact_steps: number of steps in which a fingertip did not touch.
        slip_steps: number of steps with slip.
    """

    hand: str
    millimetres: float
    degrees: float
    failure: str
    duration: float
    excess: float
    time_scale: float
    duration_ratio: float
    position_error: float
    orientation_error: float
    lost_contact_steps: int
    slip_steps: int

    @property
    def planned(self) -> bool:
        """Return whether the move was planned."""
        return bool(np.isfinite(self.duration))

    @property
    def executed(self) -> bool:
        """Return whether the plan was trackable and executed."""
        return bool(np.isfinite(self.position_error))

    @property
    def slipped(self) -> bool:
        """Return whether a fingertip lost contact or slipped."""
        return self.executed and (self.lost_contact_steps > 0 or self.slip_steps > 0)

    @property
    def arrived(self) -> bool:
        """Return whether the object arrived within 1 mm and 1°, without slip."""
        return self.executed and self.position_error <= 1.0 and self.orientation_error <= 1.0 and not self.slipped


def moves(name: str, count: int, free: bool = False) -> Iterator[Row | str]:
    """Yield the outcomes of the moves of a hand, and the reason of each unreachable move.

    Args:
        name: name of the hand.
        count: number of moves.
        free: whether the path is free.
    """
    grasp = find_grasp(Hand.load(name), Body.solid(Sphere(0.03), 0.05), HANDS[name], friction=0.7, gravity_H=SETTINGS.gravity_H)
    task, rng, done = tracking.object_task(grasp, SETTINGS), np.random.default_rng(7), 0
    for _ in range(DRAWS):
        travel, turn = rng.normal(size=(2, 3))
        travel *= rng.uniform(0.005, 0.02) / np.linalg.norm(travel)  # m
        turn *= np.radians(rng.uniform(0.0, 20.0)) / np.linalg.norm(turn)  # rad, rotation vector
        goal = Rotation.from_rotvec(turn).as_matrix() @ grasp.R_HO
        plan = plan_along(
            task,
            StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + travel, goal),
            grasp.q,
            settings=PlanSettings(intervals=INTERVALS),
        )
        if free and isinstance(plan, Plan):
            plan = plan_free(task, [grasp.p_HO, grasp.p_HO + travel], [grasp.R_HO, goal], grasp.q)
        millimetres, degrees = 1e3 * float(np.linalg.norm(travel)), float(np.degrees(np.linalg.norm(turn)))
        if isinstance(plan, Plan):
            yield execute_move(plan, grasp, millimetres, degrees)
        elif plan.kind in (UNREACHABLE, SINGULAR):
            yield plan.reason
            continue
        else:
            yield Row(name, millimetres, degrees, plan.reason, *(np.nan,) * 6, 0, 0)
        done += 1
        if done == count:
            return


def execute_move(plan: Plan, grasp: Grasp, millimetres: float, degrees: float) -> Row:
    """Scale a plan in time, execute it, and return the outcome.

    Args:
        plan: the plan.
        grasp: the grasp at the start.
        millimetres: travel of the object, mm.
        degrees: rotation of the object, °.
    """
    excess = check_at_times(plan, times_between(plan.knots.times, _INSTANTS)).excess
    scaled = tracking.time_scale_plan(plan, grasp, SETTINGS)
    move = (grasp.hand.name, millimetres, degrees)
    if not isinstance(scaled, tracking.TimeScaledPlan):
        return Row(*move, scaled.reason, plan.duration, excess, *(np.nan,) * 4, 0, 0)
    plant = simulation.Plant(simulation.build_scene(grasp, gravity_H=SETTINGS.gravity_H))
    controller = ObjectController(grasp, SETTINGS)
    run = simulation.simulate(plant, controller, scaled.reference(), scaled.duration + SETTLING_TIME)
    end = run.since(scaled.duration)
    position_error = 1e3 * float(np.linalg.norm(end.position_error, axis=1).max())
    orientation_error = float(np.degrees(np.linalg.norm(end.orientation_error, axis=1).max()))
    metrics = simulation.compute_metrics(run)
    lost, slips = metrics.lost_contact_steps, metrics.slip_steps
    failure = f"slipped: {lost} steps without contact, {slips} slip steps." if lost or slips else ""
    scales = scaled.time_scale, scaled.duration / plan.duration
    return Row(*move, failure, plan.duration, excess, *scales, position_error, orientation_error, lost, slips)


def summary(name: str, rows: list[Row], unreachable: int) -> list[str]:
    """Return the row of one hand.

    Args:
        name: name of the hand.
        rows: outcomes of its moves.
        unreachable: number of unreachable moves.
    """
    planned = [row for row in rows if row.planned]
    executed = [row for row in rows if row.executed]
    lost, slips = sum(row.lost_contact_steps for row in executed), sum(row.slip_steps for row in executed)

    def median_and_max(values: list[float], unit: str, factor: float = 1.0) -> str:
        return f"{factor * np.median(values):.3g}, {factor * max(values):.3g} {unit}" if values else "–"

    return [
        name,
        f"{unreachable} of {unreachable + len(rows)}",
        f"{len(planned)} of {len(rows)}",
        median_and_max([row.duration for row in planned], "ms", 1e3),
        median_and_max([max(row.excess, 0.0) for row in planned], "%", 100.0),
        f"{len(executed)} of {len(planned)}",
        median_and_max([row.time_scale for row in executed], "×"),
        median_and_max([row.duration_ratio for row in executed], "×"),
        median_and_max([row.position_error for row in executed], "mm"),
        median_and_max([row.orientation_error for row in executed], "°"),
        f"{sum(row.slipped for row in executed)} ({lost}, {slips} steps)",
        f"{sum(row.arrived for row in executed)} of {len(rows)}",
    ]


COLUMNS = (  # pairs of figures are median and maximum
    "hand",
    "unreachable",
    "planned",
    "duration: median, max",
    "limit excess between knots: median, max",
    "executed",
    "time scale: median, max",
    "executed / planned duration: median, max",
    "position error: median, max",
    "orientation error: median, max",
    "moves with slip (steps without contact, slip steps)",
    "arrived",
)


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("planned_moves", __doc__)
    parser.add_argument("--moves", type=int, default=20, help="number of moves for each hand (default 20)")
    parser.add_argument("--hand", choices=tuple(HANDS), action="append", help="a hand (default: all three); repeatable")
    parser.add_argument("--free", action="store_true", help="plan free moves, where the straight line is feasible")
    options = parser.parse_args()
    lines, reasons = [], []
    with Progress(SpinnerColumn(), TextColumn("{task.description}"), transient=True) as progress:
        task = progress.add_task("")
        for name in options.hand or HANDS:
            rows: list[Row] = []
            unreachable = 0
            for outcome in moves(name, options.moves, options.free):
                if isinstance(outcome, str):
                    unreachable += 1
                    continue
                rows.append(outcome)
                progress.update(task, description=f"{name}: {len(rows)} of {options.moves}")
                if outcome.failure:
                    reasons.append(f"{name}, {outcome.millimetres:.0f} mm and {outcome.degrees:.0f}°: {outcome.failure}")
            lines.append(summary(name, rows, unreachable))
            progress.console.print(" | ".join(lines[-1]), highlight=False)
    title = f"Execution of {'free ' if options.free else ''}minimum-time moves{'' if options.free else ' along straight lines'}"
    report_page.show(title, COLUMNS, lines, width=170)
    for reason in reasons:
        print(reason)
    if options.save:
        facts = report_page.facts(f"MuJoCo {mujoco.__version__}")
        failures = ["", "", "Moves not planned, not executed, or with slip:", "", *(f"- {reason}" for reason in reasons)]
        body = report_page.table(COLUMNS, lines) + ("\n".join(failures) if reasons else "")
        report_page.save(options.save, title, __doc__, facts, body)


if __name__ == "__main__":
    main()
