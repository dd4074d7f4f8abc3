"""Minimum-time moves that are executed: python -m benchmarks.planned_moves [--free] [--moves N] [--save FILE].

Three hands hold a ball of 50 g and 30 mm radius, μ = 0.7, in the hold that the search finds, palm up. Moves go 5 to 20 mm in
any direction and turn up to 20° about any axis, drawn at random with a seed; those whose goal or way a finger cannot reach, or
only stretched out, are refused and counted. Each of the others is planned along the straight line, or with --free whichever
way is faster, with contacts that roll, with a slip margin of 1 N, a tenth of friction and of motor torque and a thirtieth of
joint speed kept back, and checked at 640 instants between knots; rehearsed by the controller's law, which slows what it cannot
follow; and followed in MuJoCo with perfect measurements, its steps in acceleration softened over a few milliseconds. Arrived:
within 1 mm and 1° of the goal from the end of the move on, a tenth of a second. Slip: a fingertip without contact, or one
with no friction left, in any step.
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
DRAWS = 400  # at most, for each hand
SETTLING_TIME = 0.1  # s
_BETWEEN = 20 * SAMPLES_PER_INTERVAL  # instants between knots: twenty times those of the planner's own check


@dataclass(frozen=True, slots=True)
class Row:
    """One move: what became of it, and figures where there are any (NaN where not)."""

    hand: str
    millimetres: float
    degrees: float
    words: str
    duration: float
    excess: float
    time_scale: float
    pace: float
    off: float
    turned: float
    lost_contact_steps: int
    slip_steps: int

    @property
    def planned(self) -> bool:
        """Whether there is a plan."""
        return bool(np.isfinite(self.duration))

    @property
    def followed(self) -> bool:
        """Whether the rehearsal let it be executed."""
        return bool(np.isfinite(self.off))

    @property
    def slipped(self) -> bool:
        """Whether a fingertip was off, or slid."""
        return self.followed and (self.lost_contact_steps > 0 or self.slip_steps > 0)

    @property
    def arrived(self) -> bool:
        """Within 1 mm and 1°, without slip."""
        return self.followed and self.off <= 1.0 and self.turned <= 1.0 and not self.slipped


def moves(name: str, count: int, free: bool = False) -> Iterator[Row | str]:
    """As many moves of a hand as asked for; for each that a finger cannot reach, its reason."""
    grasp = find_grasp(Hand.load(name), Body.solid(Sphere(0.03), 0.05), HANDS[name], friction=0.7, gravity_H=SETTINGS.gravity_H)
    task, rng, done = tracking.object_task(grasp, SETTINGS), np.random.default_rng(7), 0
    for _ in range(DRAWS):
        along, axis = rng.normal(size=(2, 3))
        along *= rng.uniform(0.005, 0.02) / np.linalg.norm(along)  # m
        axis *= np.radians(rng.uniform(0.0, 20.0)) / np.linalg.norm(axis)
        goal = Rotation.from_rotvec(axis).as_matrix() @ grasp.R_HO
        plan = plan_along(
            task,
            StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + along, goal),
            grasp.q,
            settings=PlanSettings(intervals=INTERVALS),
        )
        if free and isinstance(plan, Plan):
            plan = plan_free(task, [grasp.p_HO, grasp.p_HO + along], [grasp.R_HO, goal], grasp.q)
        far, wide = 1e3 * float(np.linalg.norm(along)), float(np.degrees(np.linalg.norm(axis)))
        if isinstance(plan, Plan):
            yield execute_move(plan, grasp, far, wide)
        elif plan.kind in (UNREACHABLE, SINGULAR):
            yield plan.reason
            continue
        else:
            yield Row(name, far, wide, plan.reason, *(np.nan,) * 6, 0, 0)
        done += 1
        if done == count:
            return


def execute_move(plan: Plan, grasp: Grasp, far: float, wide: float) -> Row:
    """Rehearse a plan and follow it."""
    excess = check_at_times(plan, times_between(plan.knots.times, _BETWEEN)).excess
    pace = tracking.time_scale_plan(plan, grasp, SETTINGS)
    so_far = (grasp.hand.name, far, wide)
    if not isinstance(pace, tracking.TimeScaledPlan):
        return Row(*so_far, pace.reason, plan.duration, excess, *(np.nan,) * 4, 0, 0)
    plant = simulation.Plant(simulation.build_scene(grasp, gravity_H=SETTINGS.gravity_H))
    controller = ObjectController(grasp, SETTINGS)
    run = simulation.simulate(plant, controller, pace.reference(), pace.duration + SETTLING_TIME)
    there = run.since(pace.duration)
    off = 1e3 * float(np.linalg.norm(there.position_error, axis=1).max())
    turned = float(np.degrees(np.linalg.norm(there.orientation_error, axis=1).max()))
    metrics = simulation.compute_metrics(run)
    words = (
        f"slipped: a fingertip was off in {metrics.lost_contact_steps} steps, and slid in {metrics.slip_steps}."
        if metrics.lost_contact_steps or metrics.slip_steps
        else ""
    )
    paces = pace.time_scale, pace.duration / plan.duration
    return Row(*so_far, words, plan.duration, excess, *paces, off, turned, metrics.lost_contact_steps, metrics.slip_steps)


def summary(name: str, rows: list[Row], refused: int) -> list[str]:
    """One line of the table a hand."""
    planned = [row for row in rows if row.planned]
    followed = [row for row in rows if row.followed]
    off, sliding = sum(row.lost_contact_steps for row in followed), sum(row.slip_steps for row in followed)

    def of(values: list[float], unit: str, factor: float = 1.0) -> str:
        return f"{factor * np.median(values):.3g}, {factor * max(values):.3g} {unit}" if values else "–"

    return [
        name,
        f"{refused} of {refused + len(rows)}",
        f"{len(planned)} of {len(rows)}",
        of([row.duration for row in planned], "ms", 1e3),
        of([max(row.excess, 0.0) for row in planned], "%", 100.0),
        f"{len(followed)} of {len(planned)}",
        of([row.time_scale for row in followed], "×"),
        of([row.pace for row in followed], "×"),
        of([row.off for row in followed], "mm"),
        of([row.turned for row in followed], "°"),
        f"{sum(row.slipped for row in followed)} ({off}, {sliding} steps)",
        f"{sum(row.arrived for row in followed)} of {len(rows)}",
    ]


COLUMNS = (
    "hand",
    "out of reach",
    "planned",
    "duration: median, largest",
    "beyond limits between knots",
    "followed",
    "slowed",
    "softened and slowed",
    "off the goal: mm",
    "off the goal: °",
    "slipped: moves (steps off, steps sliding)",
    "arrived",
)


def main() -> None:
    """Measure and show."""
    parser = report_page.parser("planned_moves", __doc__)
    parser.add_argument("--moves", type=int, default=20, help="of each hand")
    parser.add_argument("--hand", choices=tuple(HANDS), action="append", help="by default all three; may be given again")
    parser.add_argument("--free", action="store_true", help="moves by whichever way is faster, of those that the line allows")
    options = parser.parse_args()
    lines, reasons = [], []
    with Progress(SpinnerColumn(), TextColumn("{task.description}"), transient=True) as progress:
        task = progress.add_task("")
        for name in options.hand or HANDS:
            rows: list[Row] = []
            refused = 0
            for found in moves(name, options.moves, options.free):
                if isinstance(found, str):
                    refused += 1
                    continue
                rows.append(found)
                progress.update(task, description=f"{name}: {len(rows)} of {options.moves}")
                if found.words:
                    reasons.append(f"{name}, {found.millimetres:.0f} mm and {found.degrees:.0f}°: {found.words}")
            lines.append(summary(name, rows, refused))
            progress.console.print(" | ".join(lines[-1]), highlight=False)
    report_page.show("Minimum-time moves, executed", COLUMNS, lines, width=170)
    for reason in reasons:
        print(reason)
    if options.save:
        facts = report_page.facts(f"MuJoCo {mujoco.__version__}")
        title = f"Minimum-time moves, {'any way' if options.free else 'along straight lines'}, executed"
        named = ["", "", "Planned or wanted, and not followed, or slipped:", "", *(f"- {reason}" for reason in reasons)]
        body = report_page.table(COLUMNS, lines) + ("\n".join(named) if reasons else "")
        report_page.save(options.save, title, __doc__, facts, body)


if __name__ == "__main__":
    main()
