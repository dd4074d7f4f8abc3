"""How long a minimum-time move along a given path takes to plan: `python -m benchmarks.min_time_path [--save FILE]`.

Three Allegro fingers with an object between them, from the question to the checked plan, with where the time goes; and the
fingers alone on the same joints' path, beside TOPP-RA, which knows no contact forces. All in turn in one process on one core,
each round a ratio to TOPP-RA's time in the same round. A plan whose check does not stand gets no time.

Then durations: one finger of each hand through four random postures, 24 paths, torque limits only, both with TOPP-RA's rule of
first order on the same grid. What TOPP-RA's takes longer than ours is what its greedy way loses next to knots where a motor
feels no inertia along the path; what a linear program solved by HiGHS proves to be the least there is differs from ours by the
gap.
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
SAME = 1e-5  # of a duration
PARTS = ("path", "dynamics", "building", "solver", "check")


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """One subject on one grid: median wall and processor time, s, median ratio to TOPP-RA, parts' shares, the duration, s."""

    subject: str
    intervals: int
    median: float
    processor: float
    ratio: float
    shares: tuple[float, ...]
    duration: float


def with_toppra(hand: Hand, path: JointPath, s: Array) -> float:
    """TOPP-RA's duration with torque and speed limits at the knots, s."""
    torque_limit = np.column_stack([hand.torque_lower, hand.torque_upper])
    torque = constraint.JointTorqueConstraint(hand.inverse_dynamics, torque_limit, np.zeros(hand.n))
    torque.set_discretization_type(constraint.DiscretizationType.Collocation)
    speed = constraint.JointVelocityConstraint(np.column_stack([-hand.velocity_limit, hand.velocity_limit]))
    found = algorithm.TOPPRA([torque, speed], OurPath(path, hand.n), gridpoints=s).compute_parameterization(0.0, 0.0)
    return float((2.0 * np.diff(s) / (found[1][1:] + found[1][:-1])).sum())


def measure(intervals: int, rounds: int) -> list[Row]:
    """All subjects on one grid."""
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
            raise SystemExit(f"no time without a plan that stands: {plan}")
        return plan.duration, plan.statistics

    subjects: dict[str, Callable[[], tuple[float, PlanningStatistics | None]]] = {
        "three fingers and an object": lambda: checked(plan_along(task, path, q, settings=PlanSettings(intervals=intervals))),
        "the fingers alone": lambda: checked(
            plan_fingers_along(FingerTask(hand), joints, settings=PlanSettings(intervals=intervals))
        ),
        "TOPP-RA, the fingers alone, unchecked": lambda: (with_toppra(hand, joints, s), None),
    }
    times, busy = np.empty((2, rounds + 1, len(subjects)))
    shares: dict[str, list[Array]] = {name: [] for name in subjects}
    durations = {}
    for i in range(rounds + 1):  # the first to warm up
        for j, (name, run_subject) in enumerate(subjects.items()):
            start, began = time.perf_counter(), time.process_time()
            durations[name], statistics = run_subject()
            times[i, j], busy[i, j] = time.perf_counter() - start, time.process_time() - began
            if statistics is not None:
                shares[name].append(np.array([getattr(statistics, part) for part in PARTS]) / times[i, j])
    ratio = np.median(times[1:] / times[1:, -1:], axis=0)
    middle_time, processor = np.median(times[1:], axis=0), np.median(busy[1:], axis=0)
    return [
        Row(
            name,
            intervals,
            float(middle_time[j]),
            float(processor[j]),
            float(ratio[j]),
            tuple(np.median(shares[name][1:], axis=0).tolist()) if shares[name] else (),
            durations[name],
        )
        for j, name in enumerate(subjects)
    ]


def compare_with_toppra(intervals: int) -> list[str]:
    """Return a row: by how much TOPP-RA's durations exceed ours, and ours the minimum."""
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
    most = [f"{100 * np.median(lost):.3g}", f"{100 * max(lost):.3g}"] if lost else ["–", "–"]
    found = [f"{len(losses) - len(lost)} of {len(losses)}", f"{same:.0e}", str(len(lost))]
    return [str(intervals), *found, *most, f"{max(gaps):.0e}"]


def markdown(rows: list[Row]) -> str:
    """Return the rows as a table."""
    parts = [f"{part} %" for part in PARTS]
    head = ["subject", "intervals", "median ms", "processor ms", "× TOPP-RA", *parts, "move ms"]
    lines = []
    for row in rows:
        shares = [f"{100 * share:.0f}" for share in row.shares] or [""] * len(PARTS)
        times = [f"{1e3 * row.median:.1f}", f"{1e3 * row.processor:.1f}", f"{row.ratio:.2f}"]
        lines.append([row.subject, str(row.intervals), *times, *shares, f"{1e3 * row.duration:.2f}"])
    return report_page.table(head, lines)


def main() -> None:
    """Measure, print, and keep what was measured with the machine's facts."""
    parser = report_page.parser("min_time_path", __doc__)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    options = parser.parse_args()
    pin(None)
    rows = [row for intervals in INTERVALS for row in measure(intervals, options.rounds)]
    head = ("intervals", "the same", "to", "TOPP-RA slower", "median %", "most %", "ours above the least")
    beside = report_page.table(head, [compare_with_toppra(intervals) for intervals in (50, 100, 200, 400)], words=0)
    table = f"{markdown(rows)}\n\n{beside}"
    print(table)
    if options.save:
        facts = (
            f"{date.today()}, Python {platform.python_version()}, "
            "one core of a machine shared with other work: read ratios and processor times."
        )
        report_page.save(options.save, "Planning a minimum-time move along a given path takes", __doc__, facts, table)


if __name__ == "__main__":
    main()
