"""Planning time and gain of free minimum-time moves: `python -m benchmarks.planning_free [--save FILE]`.

Random moves of 5 to 20 mm and up to 20° of an object between the fingertips of three shipped hands, if the straight line is
feasible. Processor times are from the task to the checked plan, including the plan along the straight line. A first move,
which is not timed, sets up the equations and solvers of each hand. "Compiled" equations run as machine code. Contacts roll, as
on round tips, or are fixed. The gain is the reduction of the duration against the straight line.
"""

from __future__ import annotations

import platform
import sys
import time
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.planning_cases import FINGERS, random_move, star_grasp

from benchmarks import report_page
from benchmarks.timing import pin
from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.planning.check import SAMPLES_PER_INTERVAL, check_at_times, times_between
from graspforce.planning.free.plan_free import plan_free
from graspforce.planning.path.paths import StraightPath
from graspforce.planning.path.plan_along import plan_along
from graspforce.planning.plan import Plan
from graspforce.planning.settings import PlanSettings
from graspforce.planning.task import GraspTask

MOVES = 20
PARTS = ("path", "dynamics", "building", "solver", "check")
FINER = 4 * SAMPLES_PER_INTERVAL  # instants in each interval, 4 times as many as in the planner's own check


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """Figures of one hand.

    Args:
        hand: name of the hand.
        compiled: whether the equations are compiled.
        rolling: whether contacts roll; otherwise they are fixed.
        attempted: number of moves.
        planned: number of planned moves.
        faster: number of moves that are faster than along the straight line.
        median: median planning time, s.
        longest: longest planning time, s.
        shares: median shares of `PARTS` in the planning time.
        gain: median reduction of the duration against the straight line, relative.
        best: largest reduction, relative.
        excess: largest excess over a limit between knots, relative to the limit.
    """

    hand: str
    compiled: bool
    rolling: bool
    attempted: int
    planned: int
    faster: int
    median: float
    longest: float
    shares: tuple[float, ...]
    gain: float
    best: float
    excess: float


def moves(name: str, count: int, rolling: bool = True) -> list[tuple[GraspTask, StraightPath, Array]]:
    """Return seeded random moves whose straight lines are feasible.

    Args:
        name: name of the hand.
        count: number of moves.
        rolling: whether contacts roll.
    """
    task, middle, q = star_grasp(Hand.load(name))
    task = replace(task, rolling=rolling)
    rng, feasible = np.random.default_rng(7), []
    while len(feasible) < count:
        path = random_move(rng, middle, (0.005, 0.02), 20.0)
        if plan_along(task, path, q, settings=PlanSettings(intervals=20)).found:
            feasible.append((task, path, q))
    return feasible


def measure(name: str, count: int, compiled: bool, rolling: bool) -> Row:
    """Measure all moves of one hand.

    Args:
        name: name of the hand.
        count: number of moves.
        compiled: whether the equations are compiled.
        rolling: whether contacts roll.
    """
    times, shares, gains, excess = [], [], [], -np.inf
    planned = 0
    for i, (task, path, q) in enumerate(moves(name, count + 1, rolling)):
        ends = path.points(np.array([0.0, 1.0]))
        start, wall = time.process_time(), time.perf_counter()
        plan = plan_free(task, ends.p, ends.R, q, settings=PlanSettings(compiled=compiled))
        seconds, wall = time.process_time() - start, time.perf_counter() - wall
        if i == 0:  # set-up
            continue
        along = plan_along(task, path, q, settings=PlanSettings(intervals=40))
        if not (isinstance(plan, Plan) and plan.check.verified):
            continue
        planned += 1
        excess = max(excess, check_at_times(plan, times_between(plan.knots.times, FINER)).excess)
        times.append(seconds)
        if isinstance(along, Plan):
            gains.append(1.0 - plan.duration / along.duration)
        if not plan.s.size:
            shares.append([getattr(plan.statistics, part) / wall for part in PARTS])
    faster = sum(gain > 0.0 for gain in gains)
    mean = tuple(np.median(shares, axis=0).tolist()) if shares else ()
    middle, longest = float(np.median(times)), max(times)
    gain = float(np.median(gains))
    return Row(name, compiled, rolling, count, planned, faster, middle, longest, mean, gain, max(gains), excess)


def markdown(rows: list[Row]) -> str:
    """Return the rows as a Markdown table."""
    parts = ("path", "evaluation", "building", "linear algebra", "check")
    head = ["hand", "fingers", "contacts", "compiled", "planned", "faster", "median s", "max s"]
    head += [*(f"{part} %" for part in parts), "median gain %", "max gain %", "max limit excess %"]
    lines = []
    for row in rows:
        kind = [row.hand, str(len(FINGERS[row.hand])), "rolling" if row.rolling else "fixed", "yes" if row.compiled else "no"]
        times = [f"{row.planned} of {row.attempted}", str(row.faster), f"{row.median:.2f}", f"{row.longest:.2f}"]
        shares = [f"{100 * share:.0f}" for share in row.shares]
        gains = [f"{100 * row.gain:.1f}", f"{100 * row.best:.1f}", f"{100 * row.excess:.3f}"]
        lines.append([*kind, *times, *shares, *gains])
    return report_page.table(head, lines, text_columns=4)


def main() -> None:
    """Measure, print the table and write the page."""
    parser = report_page.parser("planning_free", __doc__)
    parser.add_argument("--moves", type=int, default=MOVES, help=f"number of moves for each hand (default {MOVES})")
    options = parser.parse_args()
    pin(None)
    kinds = [(compiled, rolling) for rolling in (True, False) for compiled in (False, True)]
    rows = [measure(name, options.moves, *kind) for kind in kinds for name in FINGERS]
    table = markdown(rows)
    print(table)
    if options.save:
        facts = f"{date.today()}, Python {platform.python_version()}, one core of a shared machine, 40 intervals."
        report_page.save(options.save, "Planning time and gain of free minimum-time moves", __doc__, facts, table)


if __name__ == "__main__":
    main()
