"""The fastest move along a given path: path, equations, cone program, check, and mending what the check finds.

plan = plan_along(Task.holding(hand, body, contacts, fingers), Straight(p_start, R_start, p_goal, R_goal))
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.planning.check import SAMPLES_PER_INTERVAL, TOLERANCE, LimitExcess, check
from graspforce.planning.failure import IMMOVABLE, UNSOLVED, PlanFailure, joint_limit_failure
from graspforce.planning.path import program
from graspforce.planning.path.dynamics import PathDynamics, path_dynamics
from graspforce.planning.path.joint_path import contact_points, follow_object_path
from graspforce.planning.path.paths import ContactPoints, JointPath, JointPoints, ObjectPath, PosePoints, knot_grid
from graspforce.planning.path.program import LimitMargins, PathSolution
from graspforce.planning.path.static_check import find_static_failure
from graspforce.planning.plan import Plan, PlanCheck, PlanningStatistics, Trajectory
from graspforce.planning.progress import CHECK, DEFAULT_BUDGET, JOINT_PATH, PATH, PlanningBudget, ProgressCallback
from graspforce.planning.task import Task

_MAX_RESOLVES = 3  # programs solved again with more kept back, on one grid
_MAX_REFINEMENTS = 2  # times that the grid is doubled
_JOINT_PATH_SHARE = 0.4  # of the work: what the fingers' path takes, about
_MARGIN_FACTOR = 1.2  # how much more than the excess is kept back: what lies between knots changes a little with it


def plan_along(
    task: Task,
    path: ObjectPath | JointPath,
    q_start: Array | None = None,
    *,
    intervals: int = 100,
    budget: float = DEFAULT_BUDGET,
    callback: ProgressCallback | None = None,
    tolerance: float = TOLERANCE,
) -> Plan | PlanFailure:
    """The fastest move along a path from rest to rest, checked between its knots; or why there is none.

    Where the check finds that a limit is exceeded between knots, the limits next to it are tightened by as much and the
    program is solved again; where that does not do, on a grid twice as fine. Round tips roll on the object, unless the task
    says that they stay: the joints follow so that nothing slips, and contacts move over both. Where haste leaves the contact
    forces a choice they stand in the middle of what limits and friction allow.

    Args:
        task: what moves: hand, object, contacts, gravity, slip margin.
        path: the object's path, or, for fingers alone, the joints'.
        q_start: (n,) a posture near the start, rad; by default neutral. Only where fingers hold an object.
        intervals: between knots.
        budget: s after which no other program is solved. The first plan that passes its check is the answer, so what is
            stopped before has none.
        watch: called at every stage; returns False to stop.
        tolerance: how much of each limit may be exceeded between knots.

    Raises:
        InvalidInput: the path is not for the task, or nothing limits the motion.
    """
    if isinstance(path, JointPath) != (task.body is None):
        raise InvalidInput("path", type(path).__name__, "an object's path for an object, a JointPath for fingers alone")
    if not isinstance(path, JointPath):
        _check_path(path)
    if q_start is not None:
        q_start = arrays.check_array(q_start, "q_start", (task.joints,))
    planning_budget, clock = PlanningBudget(budget, callback), _Clock()
    if not planning_budget.should_continue(JOINT_PATH, 0.0):
        return planning_budget.failure()
    joints: JointPath | None = path if isinstance(path, JointPath) else None
    poses: ObjectPath | None = None if isinstance(path, JointPath) else path
    if task.hand is not None and poses is not None:
        joint_path = follow_object_path(task, poses, q_start)
        if isinstance(joint_path, PlanFailure):
            return joint_path
        joints = joint_path
    clock.stop("path")
    failure: PlanFailure | None = None
    for doubling in range(_MAX_REFINEMENTS + 1):
        if not planning_budget.should_continue(PATH, _JOINT_PATH_SHARE):
            return planning_budget.failure()
        places = _PathKnots.on(task, knot_grid(intervals * 2**doubling), poses, joints)
        failure = _check_joint_limits(task, places)
        if failure is not None:
            return failure
        dynamics = path_dynamics(task, places.s, places.poses, places.joints, places.joints_between, places.contacts)
        clock.stop("dynamics")
        failure = find_static_failure(task, places.s, places.poses, places.contacts, places.joints, (0, -1))
        if failure is not None:
            return failure
        missing = program.unreachable_wrench(dynamics)
        if missing is not None:
            return _immovable_failure(missing)
        found = _solve_and_check(task, places, dynamics, clock, tolerance, planning_budget)
        if isinstance(found, Plan) or found.kind != UNSOLVED:
            return found
        failure = found
    assert failure is not None
    return failure


@dataclass(frozen=True, eq=False, slots=True)
class _PathKnots:
    """The path at the knots."""

    s: Array
    poses: PosePoints | None
    contacts: ContactPoints | None
    joints: JointPoints | None
    joints_between: JointPoints | None

    @classmethod
    def on(cls, task: Task, s: Array, poses: ObjectPath | None, joints: JointPath | None) -> _PathKnots:
        at = None if poses is None else poses.points(s)
        here, middle = (None if joints is None else joints.points(x) for x in (s, (s[1:] + s[:-1]) / 2.0))
        return cls(s, at, None if at is None else contact_points(task, at, here), here, middle)


def _check_path(path: ObjectPath) -> None:
    """A user's own path must answer with finite arrays of the right shapes, and with rotations."""
    at = path.points(np.linspace(0.0, 1.0, 5))
    for name in ("p", "p_s", "p_ss", "omega", "omega_s"):
        arrays.check_array(getattr(at, name), f"path.points.{name}", (5, 3))
    R = arrays.check_array(at.R, "path.points.R", (5, 3, 3))
    off = float(np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max())
    if off > 1e-9:  # rounding, where PosePoints are computed; written by hand they would be constants
        raise InvalidInput("path.points.R", R, f"rotations: RᵀR = 1 (it is off by {off:.1g})")


class _Clock:
    """Seconds by what they went into."""

    def __init__(self) -> None:
        self.seconds = {"path": 0.0, "dynamics": 0.0, "building": 0.0, "solver": 0.0, "check": 0.0}
        self.solves = 0
        self._last = time.perf_counter()

    def stop(self, part: str, solver: float = 0.0) -> None:
        """The time since the last stop goes to a part, but for what the solver took."""
        now = time.perf_counter()
        self.seconds[part] += now - self._last - solver
        self.seconds["solver"] += solver
        self._last = now


def _check_joint_limits(task: Task, places: _PathKnots) -> PlanFailure | None:
    """A joint's path beyond its limits, at the first knot where it is."""
    if places.joints is None or task.hand is None:
        return None
    hand, q = task.hand, places.joints.q
    if q.shape[1] != hand.n:
        raise InvalidInput("path", f"{q.shape[1]} joints", f"a path of the hand's {hand.n} joints")
    beyond = np.maximum(hand.q_lower - q, q - hand.q_upper)
    at, joint = np.unravel_index(int((beyond > TOLERANCE * (hand.q_upper - hand.q_lower)).argmax()), beyond.shape)
    if beyond[at, joint] <= TOLERANCE * (hand.q_upper - hand.q_lower)[joint]:
        return None
    return joint_limit_failure(float(places.s[at]), hand.joints[joint], float(q[at, joint]))


def _solve_and_check(
    task: Task, places: _PathKnots, dynamics: PathDynamics, clock: _Clock, tolerance: float, planning_budget: PlanningBudget
) -> Plan | PlanFailure:
    """Solve, check, and keep more back where the check says so."""
    margins = LimitMargins.none(dynamics, task.slip_margin)
    plan: Plan | None = None
    for _ in range(_MAX_RESOLVES + 1):
        if not planning_budget.should_continue(PATH, 1.0 - (1.0 - _JOINT_PATH_SHARE) * 0.5**clock.solves):
            return planning_budget.failure()
        solution = program.solve(dynamics, margins, seconds=planning_budget.remaining)
        clock.solves += 1
        clock.stop("building", 0.0 if solution is None else solution.seconds)
        times = None if solution is None else knot_times(places.s, solution.b, solution.a)
        if planning_budget.remaining <= 0.0 and solution is None:
            continue  # and be told so
        if solution is None or times is None:
            break
        plan = _unchecked_plan(task, places, dynamics, solution, times, clock)
        found, over = check(plan, tolerance)
        clock.stop("check")
        plan = replace(
            plan,
            check=found,
            statistics=PlanningStatistics(**clock.seconds, solves=clock.solves, iterations=solution.iterations),
        )
        if found.verified:
            planning_budget.add_plan(plan)
            planning_budget.should_continue(CHECK, 1.0)
            return plan
        margins = _increase_margins(task, margins, over)
    if plan is None:
        everywhere = find_static_failure(task, places.s, places.poses, places.contacts, places.joints, range(len(places.s)))
        if everywhere is not None:
            return everywhere
        return PlanFailure(UNSOLVED, "The solver found no motion along the path, although nothing stands against a slow one.")
    return PlanFailure(UNSOLVED, _check_failure_text(plan.check))


def _unchecked_plan(
    task: Task, places: _PathKnots, dynamics: PathDynamics, solution: PathSolution, times: Array, clock: _Clock
) -> Plan:
    """The program's answer as states at times; not yet checked."""
    b, a, f = solution.b[:, None], solution.a[:, None], solution.f
    rate = np.sqrt(b)  # 1/s
    K = len(times)
    q = v = acc = np.zeros((K, task.joints))
    if places.joints is not None:
        q, v, acc = places.joints.q, places.joints.q_s * rate, places.joints.q_s * a + places.joints.q_ss * b
    p, R, twist, acceleration = np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 6)), np.zeros((0, 6))
    p_OC, R_OC, p_OC_d = np.zeros((0, 0, 3)), np.zeros((0, 0, 3, 3)), np.zeros((0, 0, 3))
    if places.poses is not None and places.contacts is not None:
        at, touch = places.poses, places.contacts
        p, R, p_OC, R_OC, p_OC_d = at.p, at.R, touch.p_OC, touch.R_OC, touch.p_OC_s * rate[:, None]
        spin, turn = ((R @ x[:, :, None])[:, :, 0] for x in (at.omega * rate, at.omega * a + at.omega_s * b))
        twist, acceleration = np.hstack([at.p_s * rate, spin]), np.hstack([at.p_s * a + at.p_ss * b, turn])
    tau = dynamics.torque(solution.b, solution.a, f)
    knots = Trajectory(times, q, v, acc, tau, f, p, R, twist, acceleration, p_OC, R_OC, p_OC_d).frozen()
    unchecked = PlanCheck(*(np.inf,) * 8, samples=0, tolerance=0.0)
    statistics = PlanningStatistics(**clock.seconds, solves=clock.solves, iterations=solution.iterations)
    return Plan(task, knots, unchecked, solution.optimality_gap, statistics, arrays.freeze(places.s))


def knot_times(s: Array, b: Array, a: Array) -> Array | None:
    """(K,) when each knot is passed, ∫ds/√b with a linear between knots; None where the motion would stop on its way.

    By Gauss's rule, to rounding; next to a knot at rest, where 1/√b is infinite, in the root of the distance from it.
    """
    step, slope = np.diff(s), np.diff(a)
    x, weight = np.polynomial.legendre.leggauss(16)
    u, weight = (1.0 + x) / 2.0, weight / 2.0
    durations = np.empty(len(step))
    inner = slice(1, -1)
    h = step[inner, None]
    square = b[1:-2, None] + h * u * (2.0 * a[1:-2, None] + slope[inner, None] * u)  # 1/s²
    ends = np.array([[a[0], slope[0], step[0]], [-a[-1], slope[-1], step[-1]]])[:, :, None]
    leaving = ends[:, 0] * 2.0 + ends[:, 1] * u**2  # b over the distance from rest, 1/s²
    if min(float(square.min(initial=1.0)), float(leaving.min())) <= 0.0:
        return None
    durations[inner] = (h / np.sqrt(square)) @ weight
    durations[[0, -1]] = (2.0 * np.sqrt(ends[:, 2] / leaving)) @ weight
    return np.concatenate([[0.0], np.cumsum(durations)])


def _increase_margins(task: Task, margins: LimitMargins, over: LimitExcess) -> LimitMargins:
    """The reserve with what was exceeded in the intervals next to each knot added."""
    K = len(margins.speed)

    def worst(x: Array) -> Array:
        """(K, …) the largest of the instants in the intervals on both sides of each knot, zero where none is exceeded."""
        inside = x[:-1].reshape(K - 1, SAMPLES_PER_INTERVAL, -1).max(axis=1)
        ends = x[::SAMPLES_PER_INTERVAL]
        both = np.maximum(np.vstack([inside, ends[-1:]]), np.vstack([ends[:1], inside]))
        return np.asarray(_MARGIN_FACTOR * np.maximum(both, 0.0))

    speed = margins.speed
    if task.hand is not None:
        speed = speed + 2.0 * worst(over.speed / task.hand.velocity_limit).max(axis=1)  # b goes with the square
    return LimitMargins(
        margins.slip + worst(over.slip), margins.normal + worst(over.normal), margins.torque + worst(over.torque), speed
    )


def _immovable_failure(wrench: Array) -> PlanFailure:
    force, moment = (", ".join(f"{x:.2f}" for x in part) for part in (wrench[:3], wrench[3:]))
    reason = (
        "The contacts can hold the object still but cannot move it as the path asks: no forces at them make the wrench with "
        f"force ({force}) N and moment ({moment}) N·m that setting it going needs."
    )
    return PlanFailure(IMMOVABLE, reason)


def _check_failure_text(found: PlanCheck) -> str:
    words = {
        "slip": "friction",
        "normal": "a normal force's limit",
        "torque": "a motor's limit",
        "speed": "a joint's speed limit",
        "position": "a joint's position limit",
    }
    worst = max(words, key=lambda name: getattr(found, name))
    if found.unmet > found.tolerance:
        return f"The plan needs wrenches of which no forces at the contacts make {100 * found.unmet:.2g} %."
    if found.excess > found.tolerance:
        return f"Between its knots the plan exceeds {words[worst]} by {100 * found.excess:.2g} %, however fine its grid."
    return f"Between its knots a fingertip leaves its contact by {1e3 * found.drift:.2g} mm, however fine the grid."
