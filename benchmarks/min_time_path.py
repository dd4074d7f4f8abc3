"""Planning time of minimum-time moves along a given path: `python -m benchmarks.min_time_path [--save FILE]`.

The first table has the time from the task to the checked plan. Subjects are three Allegro fingers with an object, and the
fingers alone on the same path of the joints. The peer is TOPP-RA (Pham and Pham 2018), which does not model contact forces. All
subjects take turns in one process on one core. Ratios are to the time of TOPP-RA in the same round. Plans must pass the check.

The second table compares the durations of the moves, with torque limits only: one finger of each hand through four random
postures, 24 paths. Both planners use the first-order discretisation of TOPP-RA on the same grid. TOPP-RA is greedy, and loses
time next to knots where a motor has no inertia along the path. The gap is the relative distance of our duration from a lower
bound, which HiGHS computes by linear programming.
"""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "planning"))

from support.planning_cases import AXES, star_grasp
from test_toppra import OurPath, least_duration, ours, theirs, winding
from toppra import algorithm, constraint

from benchmarks import report_page
from benchmarks.timing import pin
from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand
from graspforce.planning.path import program
from graspforce.planning.path.joint_path import follow_object_path
from graspforce.planning.path.paths import JointPath, StraightPath, knot_grid
from graspforce.planning.path.plan_along import plan_along, plan_fingers_along
from graspforce.planning.path.program_rows import LimitMargins
from graspforce.planning.plan import Plan, PlanningStatistics
from graspforce.planning.settings import PlanSettings
from graspforce.planning.task import FingerTask

INTERVALS = (25, 50, 100, 200)
ROUNDS = 15
SAME = 1e-5  # relative difference below which two durations count as equal
PARTS = ("path", "dynamics", "building", "solver", "check")


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """Times of one subject on one grid.

    Args:
        subject: name of the subject.
        intervals: number of intervals.
        median: median wall-clock time, s.
        processor: median processor time, s.
        ratio: median of the time over that of TOPP-RA in the same round.
        shares: median shares of `PARTS` in the time; empty for TOPP-RA.
        duration: duration of the move, s.
    """

    subject: str
    intervals: int
    median: float
    processor: float
    ratio: float
    shares: tuple[float, ...]
    duration: float


def with_toppra(hand: Hand, path: JointPath, s: Array) -> float:
    """Return the duration by TOPP-RA with torque and speed limits at the knots, s."""
    torque_limit = np.column_stack([hand.torque_lower, hand.torque_upper])
    torque = constraint.JointTorqueConstraint(hand.inverse_dynamics, torque_limit, np.zeros(hand.n))
    torque.set_discretization_type(constraint.DiscretizationType.Collocation)
    speed = constraint.JointVelocityConstraint(np.column_stack([-hand.velocity_limit, hand.velocity_limit]))
    found = algorithm.TOPPRA([torque, speed], OurPath(path, hand.n), gridpoints=s).compute_parameterization(0.0, 0.0)
    return float((2.0 * np.diff(s) / (found[1][1:] + found[1][:-1])).sum())


def measure(intervals: int, rounds: int) -> list[Row]:
    """Measure all subjects on one grid.

    Args:
        intervals: number of intervals.
        rounds: number of timed rounds.
    """
    hand = Hand.load("allegro_right")
    task, middle, q = star_grasp(hand)
    path = StraightPath(
        middle, AXES, middle + np.array([-0.004, 0.004, 0.006]), Rotation.from_rotvec([0.1, 0.1, 0.02]).as_matrix()
    )
    joints = follow_object_path(task, path, q)
    assert isinstance(joints, JointPath)
    s = knot_grid(intervals)

    def checked(plan: object) -> tuple[float, PlanningStatistics]:
        if not (isinstance(plan, Plan) and plan.check.verified):
            raise SystemExit(f"The plan is missing or fails its check: {plan}")
        return plan.duration, plan.statistics

    subjects: dict[str, Callable[[], tuple[float, PlanningStatistics | None]]] = {
        "three fingers and an object": lambda: checked(plan_along(task, path, q, settings=PlanSettings(intervals=intervals))),
        "fingers alone": lambda: checked(
            plan_fingers_along(FingerTask(hand), joints, settings=PlanSettings(intervals=intervals))
        ),
        "TOPP-RA, fingers alone, not checked": lambda: (with_toppra(hand, joints, s), None),
    }
    times, processor_times = np.empty((2, rounds + 1, len(subjects)))
    shares: dict[str, list[Array]] = {name: [] for name in subjects}
    durations = {}
    for i in range(rounds + 1):  # the first round is not timed
        for j, (name, run_subject) in enumerate(subjects.items()):
            start, processor_start = time.perf_counter(), time.process_time()
            durations[name], statistics = run_subject()
            times[i, j], processor_times[i, j] = time.perf_counter() - start, time.process_time() - processor_start
            if statistics is not None:
                shares[name].append(np.array([getattr(statistics, part) for part in PARTS]) / times[i, j])
    ratio = np.median(times[1:] / times[1:, -1:], axis=0)
    median, processor = np.median(times[1:], axis=0), np.median(processor_times[1:], axis=0)
    return [
        Row(
            name,
            intervals,
            float(median[j]),
            float(processor[j]),
            float(ratio[j]),
            tuple(np.median(shares[name][1:], axis=0).tolist()) if shares[name] else (),
            durations[name],
        )
        for j, name in enumerate(subjects)
    ]


def compare_with_toppra(intervals: int) -> list[str]:
    """Return the row of one grid: the excess of TOPP-RA's durations over ours, and of ours over the lower bound."""
    losses, gaps = [], []
    for name in ("four_finger", "dlr_hit2", "allegro_right"):
        hand = Hand.load(name)
        for seed in range(8):
            path = winding(hand, seed)
            dynamics = ours(hand, path, knot_grid(intervals))
            answer = program.solve(dynamics, LimitMargins.slip_only(dynamics), "left")
            assert answer is not None
            losses.append(theirs(hand, path, dynamics.s, float(np.sqrt(answer.b.max())))[0] / answer.duration - 1.0)
            gaps.append(abs(1.0 - least_duration(dynamics, answer.b) / answer.duration))
    lost = [loss for loss in losses if loss > SAME]
    same = max((abs(loss) for loss in losses if loss <= SAME), default=0.0)
    excess = [f"{100 * np.median(lost):.3g}", f"{100 * max(lost):.3g}"] if lost else ["–", "–"]
    counts = [f"{len(losses) - len(lost)} of {len(losses)}", f"{same:.0e}", str(len(lost))]
    return [str(intervals), *counts, *excess, f"{max(gaps):.0e}"]


def markdown(rows: list[Row]) -> str:
    """Return the rows as a Markdown table."""
    parts = [f"{part} %" for part in PARTS]
    head = ["subject", "intervals", "median ms", "processor ms", "× TOPP-RA", *parts, "move ms"]
    lines = []
    for row in rows:
        shares = [f"{100 * share:.0f}" for share in row.shares] or [""] * len(PARTS)
        times = [f"{1e3 * row.median:.1f}", f"{1e3 * row.processor:.1f}", f"{row.ratio:.2f}"]
        lines.append([row.subject, str(row.intervals), *times, *shares, f"{1e3 * row.duration:.2f}"])
    return report_page.table(head, lines)


def main() -> None:
    """Measure, print the tables and write the page."""
    parser = report_page.parser("min_time_path", __doc__)
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"timed rounds (default {ROUNDS})")
    options = parser.parse_args()
    pin(None)
    rows = [row for intervals in INTERVALS for row in measure(intervals, options.rounds)]
    head = (
        "intervals",
        "equal durations",
        "largest difference",
        "TOPP-RA longer",
        "median %",
        "max %",
        "gap to the lower bound",
    )
    comparison = report_page.table(head, [compare_with_toppra(intervals) for intervals in (50, 100, 200, 400)], text_columns=0)
    table = f"{markdown(rows)}\n\n{comparison}"
    print(table)
    if options.save:
        facts = (
            f"{date.today()}, Python {platform.python_version()}, one core of a shared machine; use ratios and processor times."
        )
        report_page.save(options.save, "Planning time of minimum-time moves along a given path", __doc__, facts, table)


if __name__ == "__main__":
    main()
