"""How long free minimum-time moves take to plan, and what they gain: `python -m benchmarks.planning_free [--save FILE]`.

Random moves of 5 to 20 mm and up to 20° of an object between the fingertips of three shipped hands, of those that the fingers
can follow along a straight line. Times are from the question to the checked plan, the straight path's plan included, the
equations and solvers of each hand made beforehand by a move that is not counted; CPU seconds, since others work on the machine.
"Compiled" is the same with the equations as machine code. Contacts roll, as round tips do, or stay where they are.
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
FINER = (
    4 * SAMPLES_PER_INTERVAL
)  # times inside each interval at which the finer check looks, four times as many as the planner's own


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """One hand, with contacts that roll or stay.

    Moves asked, planned, and found faster than the straight path; times, s; what was gained; the worst excess.
    """

    hand: str
    compiled: bool
    rolling: bool
    asked: int
    planned: int
    faster: int
    median: float
    longest: float
    shares: tuple[float, ...]
    gain: float
    best: float
    excess: float


def moves(name: str, count: int, rolling: bool = True) -> list[tuple[GraspTask, StraightPath, Array]]:
    """Return moves along which the fingers can follow; always the same."""
    task, middle, q = star_grasp(Hand.load(name))
    task = replace(task, rolling=rolling)
    rng, found = np.random.default_rng(7), []
    while len(found) < count:
        path = random_move(rng, middle, (0.005, 0.02), 20.0)
        if plan_along(task, path, q, settings=PlanSettings(intervals=20)).found:
            found.append((task, path, q))
    return found


def measure(name: str, count: int, compiled: bool, rolling: bool) -> Row:
    """All moves of one hand."""
    times, shares, gains, excess = [], [], [], -np.inf
    planned = 0
    for i, (task, path, q) in enumerate(moves(name, count + 1, rolling)):
        at = path.points(np.array([0.0, 1.0]))
        start, wall = time.process_time(), time.perf_counter()
        plan = plan_free(task, at.p, at.R, q, settings=PlanSettings(compiled=compiled))
        seconds, wall = time.process_time() - start, time.perf_counter() - wall
        if i == 0:  # made everything
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
    """Return the rows as a table."""
    words = ("path", "evaluating", "building", "linear algebra", "check")
    head = ["hand", "fingers", "contacts", "compiled", "planned", "faster", "median s", "longest s"]
    head += [*(f"{word} %" for word in words), "gain, median %", "most %", "excess %"]
    lines = []
    for row in rows:
        kind = [row.hand, str(len(FINGERS[row.hand])), "roll" if row.rolling else "stay", "yes" if row.compiled else "no"]
        found = [f"{row.planned} of {row.asked}", str(row.faster), f"{row.median:.2f}", f"{row.longest:.2f}"]
        shares = [f"{100 * share:.0f}" for share in row.shares]
        gains = [f"{100 * row.gain:.1f}", f"{100 * row.best:.1f}", f"{100 * row.excess:.3f}"]
        lines.append([*kind, *found, *shares, *gains])
    return report_page.table(head, lines, words=4)


def main() -> None:
    """Measure, print, and keep what was measured with the machine's facts."""
    parser = report_page.parser("planning_free", __doc__)
    parser.add_argument("--moves", type=int, default=MOVES)
    options = parser.parse_args()
    pin(None)
    kinds = [(compiled, rolling) for rolling in (True, False) for compiled in (False, True)]
    rows = [measure(name, options.moves, *kind) for kind in kinds for name in FINGERS]
    table = markdown(rows)
    print(table)
    if options.save:
        facts = f"{date.today()}, Python {platform.python_version()}, one core of a shared machine, 40 intervals."
        report_page.save(options.save, "Free minimum-time moves", __doc__, facts, table)


if __name__ == "__main__":
    main()
