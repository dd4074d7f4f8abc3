"""Minimum-time planners along a given path: `plan_along` for an object, `plan_fingers_along` for fingers alone.

Both compute the joints' path, the dynamics at the knots and the fastest motion as a cone program, then check it between the
knots. Where the check finds an excess, the adjacent limits are tightened by as much and the program is solved again; if that
does not suffice, it is solved on a grid twice as fine.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.planning import collisions
from graspforce.planning.check import SAMPLES_PER_INTERVAL, LimitExcess, acceleration_limits, check, jerk_excess
from graspforce.planning.collisions import path_collision, scene_of_task
from graspforce.planning.failure import UNSOLVED, PlanFailure, joint_limit_failure
from graspforce.planning.given_points import METRES_PER_RADIAN, MIN_DISTANCE, check_start_posture
from graspforce.planning.path import program
from graspforce.planning.path.dynamics import PathDynamics, path_dynamics
from graspforce.planning.path.eased_path import EasedJointPath, EasedObjectPath, ease, even_knots
from graspforce.planning.path.immovable import missing_wrench_failure, slow_motion_failure
from graspforce.planning.path.jerk import PathJerks
from graspforce.planning.path.joint_path import follow_object_path
from graspforce.planning.path.knots import PathKnots
from graspforce.planning.path.paths import JointPath, ObjectPath, knot_grid
from graspforce.planning.path.program import PathSolution
from graspforce.planning.path.program_rows import LimitMargins
from graspforce.planning.path.static_check import find_static_failure
from graspforce.planning.plan import LIMIT_WORDS, Plan, PlanCheck, PlanningStatistics
from graspforce.planning.progress import CHECK, JOINT_PATH, PATH, PlanningBudget, ProgressCallback
from graspforce.planning.settings import DEFAULT_TOLERANCE, PATH_INTERVALS, PlanSettings
from graspforce.planning.task import FingerTask, HandTask, IdealTask, ObjectTask, Task
from graspforce.planning.trajectory import Trajectory

_MAX_RESOLVES = 3  # programs solved again on one grid with larger margins
_MAX_REFINEMENTS = 2  # times that the grid is doubled
_JOINT_PATH_SHARE = 0.4  # of the work: the joints' path, approximately
_SMALL_EXCESS = 0.1  # of jerk: a smaller one tightens its limits everywhere, not only where it is
_MARGIN_FACTOR = 1.2  # margin over excess: a new motion has slightly different values between the knots


def plan_along(
    task: ObjectTask,
    path: ObjectPath,
    q_start: npt.ArrayLike | None = None,
    *,
    settings: PlanSettings | None = None,
    callback: ProgressCallback | None = None,
) -> Plan | PlanFailure:
    """Plan the fastest move of an object along a path, from rest to rest, and check it between its knots.

    Round fingertips roll on the object, unless the task says that they do not. The joints follow so that no contact slips, and
    the contacts move over finger and object. Where the contact forces of the fastest motion are not unique, those farthest
    from friction and force limits are taken.

    Args:
        task: a hand with an object, or an object between ideal fingers.
        path: the object's path.
        q_start: (n,) posture near the start, rad; the neutral posture by default. Ideal fingers have none.
        settings: number of intervals (default 100), tolerance and budget. No program is solved after the budget has ended;
            then there is no plan, since the first plan that passes its check is the result.
        callback: function called with the `Progress` at every stage; it returns False to stop.

    Returns:
        The plan, or the reason why there is none.

    Raises:
        InvalidInput: a path with wrong shapes, or nothing limits the motion.
    """
    _check_path(task, path)
    q_start = check_start_posture(task, q_start)
    run = _Run.begin(settings, callback)
    if not run.budget.should_continue(JOINT_PATH, 0.0):
        return run.budget.failure()
    if isinstance(task, IdealTask):
        return _plan_on_grids(task, partial(PathKnots.of_ideal_fingers, task, _eased(task, path)), run)
    joints = follow_object_path(task, path, q_start)
    if isinstance(joints, PlanFailure):
        return joints
    knots_at = partial(PathKnots.of_grasp, task, _eased(task, path), _eased_joints(task, joints))
    return _plan_on_grids(task, knots_at, run, partial(_collision, path, joints))


def plan_fingers_along(
    task: FingerTask,
    path: JointPath,
    *,
    settings: PlanSettings | None = None,
    callback: ProgressCallback | None = None,
) -> Plan | PlanFailure:
    """Plan the fastest move of fingers alone along a path of the joints, from rest to rest, and check it between its knots.

    Args:
        task: the hand.
        path: the joints' path.
        settings: as `plan_along`.
        callback: as `plan_along`.

    Returns:
        The plan, or the reason why there is none.

    Raises:
        InvalidInput: a path of another number of joints, or without motion.
    """
    _check_joint_path(task, path)
    run = _Run.begin(settings, callback)
    if not run.budget.should_continue(JOINT_PATH, 0.0):
        return run.budget.failure()
    knots_at = partial(PathKnots.of_fingers, _eased_joints(task, path))
    return _plan_on_grids(task, knots_at, run, partial(_collision, None, path))


@dataclass(eq=False, slots=True)
class _Run:
    """One call of a planner: its settings, its budget, and the seconds spent on each part."""

    settings: PlanSettings
    budget: PlanningBudget
    seconds: dict[str, float]
    solves: int = 0
    _last_stop: float = field(default_factory=time.perf_counter)

    @classmethod
    def begin(cls, settings: PlanSettings | None, callback: ProgressCallback | None) -> _Run:
        settings = PlanSettings() if settings is None else settings
        seconds = dict.fromkeys(("path", "dynamics", "building", "solver", "check"), 0.0)
        return cls(settings, PlanningBudget(settings.budget, callback), seconds)

    @property
    def intervals(self) -> int:
        return PATH_INTERVALS if self.settings.intervals is None else self.settings.intervals

    def record_time(self, part: str, solver: float = 0.0) -> None:
        """Add the time since the last call to a part, and ``solver`` s of it to the solver."""
        now = time.perf_counter()
        self.seconds[part] += now - self._last_stop - solver
        self.seconds["solver"] += solver
        self._last_stop = now

    def statistics(self, solution: PathSolution) -> PlanningStatistics:
        return PlanningStatistics(**self.seconds, solves=self.solves, iterations=solution.iterations)


def _plan_on_grids(
    task: Task,
    knots_at: Callable[[Array], PathKnots],
    run: _Run,
    find_collision: Callable[[Task, int], PlanFailure | None] = lambda task, intervals: None,
) -> Plan | PlanFailure:
    """Plan on grids of increasing fineness until a plan passes its check."""
    run.record_time("path")
    failure = PlanFailure(UNSOLVED, "No grid was tried.")
    for doubling in range(_MAX_REFINEMENTS + 1):
        if not run.budget.should_continue(PATH, _JOINT_PATH_SHARE):
            return run.budget.failure()
        count = run.intervals * 2**doubling
        knots = knots_at(even_knots(count) if task.acceleration_limits.has_jerk else knot_grid(count))
        beyond_limits = _joint_limit_failure(task, knots)
        if beyond_limits is not None:
            return beyond_limits
        dynamics = path_dynamics(task, knots)
        run.record_time("dynamics")
        static_failure = find_static_failure(task, knots, (0, -1))
        if static_failure is not None:
            return static_failure
        immovable = missing_wrench_failure(dynamics) or slow_motion_failure(task, knots, dynamics)
        if immovable is not None:
            return immovable
        collision = find_collision(task, run.intervals) if doubling == 0 else None
        if collision is not None:
            return collision
        result = _solve_and_check(task, knots, dynamics, run)
        if isinstance(result, Plan) or result.kind != UNSOLVED:
            return result
        failure = result
    return failure


def _collision(path: ObjectPath | None, joints: JointPath, task: Task, intervals: int) -> PlanFailure | None:
    """Return the failure of a path with a collision, of the object too if it has a path; None if there is none."""
    s = np.linspace(0.0, 1.0, collisions.SAMPLES_PER_INTERVAL * intervals + 1)
    poses = None if path is None else path.points(s)
    return path_collision(scene_of_task(task), s, joints.points(s).q, None if poses is None else (poses.p, poses.R))


def _eased(task: Task, path: ObjectPath) -> ObjectPath:
    """Return a path, eased at its ends if the task limits jerk."""
    return EasedObjectPath(path) if task.acceleration_limits.has_jerk else path


def _eased_joints(task: Task, path: JointPath) -> JointPath | EasedJointPath:
    """Return a path of joints, eased at its ends if the task limits jerk."""
    return EasedJointPath(path) if task.acceleration_limits.has_jerk else path


def _check_path(task: Task, path: ObjectPath | JointPath) -> None:
    """Raise InvalidInput unless a path gives finite arrays of the right shapes, with rotation matrices."""
    if not isinstance(task, ObjectTask):
        raise InvalidInput("task", type(task).__name__, "a GraspTask or an IdealTask; plan_fingers_along takes a FingerTask")
    if isinstance(path, JointPath):
        raise InvalidInput("path", "JointPath", "a path of the object; plan_fingers_along takes a path of the joints")
    at = path.points(np.linspace(0.0, 1.0, 5))
    for name in ("p", "p_s", "p_ss", "omega", "omega_s"):
        arrays.check_array(getattr(at, name), f"path.points.{name}", (5, 3))
    R = arrays.check_array(at.R, "path.points.R", (5, 3, 3))
    if max(np.abs(at.p_s).max(), METRES_PER_RADIAN * np.abs(at.omega).max()) < MIN_DISTANCE:
        raise InvalidInput("path", type(path).__name__, "a path along which something moves")
    error = float(np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max())
    if error > 1e-9:  # computed rotations are this exact
        raise InvalidInput("path.points.R", R, f"rotation matrices, RᵀR = 1; |RᵀR − 1| is {error:.1g}")


def _check_joint_path(task: Task, path: ObjectPath | JointPath) -> None:
    """Raise InvalidInput unless a path has the hand's joints."""
    if not isinstance(task, FingerTask):
        raise InvalidInput("task", type(task).__name__, "a FingerTask; plan_along takes a task with an object")
    if not isinstance(path, JointPath):
        raise InvalidInput("path", type(path).__name__, "a JointPath; plan_along takes a path of an object")
    count = path.points(np.zeros(1)).q.shape[1]
    if count != task.hand.n:
        raise InvalidInput("path", f"{count} joints", f"a path of the hand's {task.hand.n} joints")


def _joint_limit_failure(task: Task, knots: PathKnots) -> PlanFailure | None:
    """Return the failure at the first knot at which a joint exceeds its limits; None if all joints stay inside."""
    if not isinstance(task, HandTask):
        return None
    hand, q = task.hand, knots.joints.q
    excess = np.maximum(hand.q_lower - q, q - hand.q_upper) - DEFAULT_TOLERANCE * (hand.q_upper - hand.q_lower)
    at, joint = np.unravel_index(int((excess > 0.0).argmax()), excess.shape)
    if excess[at, joint] <= 0.0:
        return None
    return joint_limit_failure(float(knots.s[at]), hand.joints[joint], float(q[at, joint]))


def _solve_and_check(task: Task, knots: PathKnots, dynamics: PathDynamics, run: _Run) -> Plan | PlanFailure:
    """Solve and check on one grid, with larger margins where the check finds an excess."""
    margins = LimitMargins.slip_only(dynamics, task.slip_margin if isinstance(task, ObjectTask) else 0.0)
    jerks, jerk_share = PathJerks.of_path(task, knots), np.ones(len(knots.s) - 1)
    plan: Plan | None = None
    for _ in range(_MAX_RESOLVES + 1):
        if not run.budget.should_continue(PATH, 1.0 - (1.0 - _JOINT_PATH_SHARE) * 0.5**run.solves):
            return run.budget.failure()
        if jerks is None:
            solution = program.solve(dynamics, margins, seconds=run.budget.remaining)
        else:
            solution = program.solve_with_jerk(dynamics, margins, jerks, jerk_share, run.budget.remaining)
        run.solves += 1
        run.record_time("building", 0.0 if solution is None else solution.seconds)
        if solution is None and run.budget.remaining <= 0.0:
            continue  # the next round reports the end of the budget
        times = None if solution is None else knot_times(knots.s, solution.b, solution.a, jerks is None)
        if solution is None or times is None:
            break
        plan = _unchecked_plan(task, knots, dynamics, solution, times, run)
        checked, over = check(plan, run.settings.tolerance)
        run.record_time("check")
        plan = replace(plan, check=checked, statistics=run.statistics(solution))
        if checked.verified:
            run.budget.add_plan(plan)
            run.budget.should_continue(CHECK, 1.0)
            return plan
        margins = _increase_margins(task, margins, over)
        jerk_share = _smaller_share(jerk_share, np.maximum(jerk_excess(plan), 0.0))
    if plan is not None:
        return PlanFailure(UNSOLVED, _check_failure_text(plan.check))
    static_failure = find_static_failure(task, knots, range(len(knots.s)))
    if static_failure is not None:
        return static_failure
    return PlanFailure(UNSOLVED, "The solver found no motion along the path, although a slow one may exist.")


def _unchecked_plan(
    task: Task, knots: PathKnots, dynamics: PathDynamics, solution: PathSolution, times: Array, run: _Run
) -> Plan:
    """Return the program's solution as a plan whose check is still to be made."""
    b, a, f = solution.b[:, None], solution.a[:, None], solution.f
    rate = np.sqrt(b)  # 1/s
    joints, at, points = knots.joints, knots.poses, knots.contacts
    q, v, acc = joints.q, joints.q_s * rate, joints.q_s * a + joints.q_ss * b
    b, a, rate = (x[: len(at.p)] for x in (b, a, rate))  # fingers alone have no poses
    omega, alpha = ((at.R @ x[:, :, None])[:, :, 0] for x in (at.omega * rate, at.omega * a + at.omega_s * b))
    twist, acceleration = np.hstack([at.p_s * rate, omega]), np.hstack([at.p_s * a + at.p_ss * b, alpha])
    tau = dynamics.torque(solution.b, solution.a, f)
    contacts = (points.p_OC, points.R_OC, points.p_OC_s * rate[:, None])
    states = Trajectory(times, q, v, acc, tau, f, at.p, at.R, twist, acceleration, *contacts).frozen()
    unchecked = PlanCheck.not_made(run.settings.tolerance)
    s = ease(knots.s)[0] if task.acceleration_limits.has_jerk else knots.s
    return Plan(task, states, unchecked, solution.optimality_gap, run.statistics(solution), arrays.freeze(s))


def knot_times(s: Array, b: Array, a: Array, rests: bool = True) -> Array | None:
    """Return the times at which the knots are passed, ∫ds/√b with a linear between knots, s.

    Gauss–Legendre quadrature of 16 points. Next to a knot at rest, where 1/√b is infinite, it is in the root of the distance.

    Args:
        s: (K,) path parameters of the knots.
        b: (K,) ṡ² at the knots, 1/s².
        a: (K,) s̈ at the knots, 1/s².
        rests: whether b is zero at both ends.

    Returns:
        (K,) times, or None if the motion would stop on its way.
    """
    step, slope = np.diff(s), np.diff(a)
    x, weight = np.polynomial.legendre.leggauss(16)
    u, weight = (1.0 + x) / 2.0, weight / 2.0
    durations = np.empty(len(step))
    inner = slice(1, -1) if rests else slice(None)
    h = step[inner, None]
    square = b[:-1][inner, None] + h * u * (2.0 * a[:-1][inner, None] + slope[inner, None] * u)  # 1/s²
    if not rests:
        if float(square.min()) <= 0.0:
            return None
        return np.concatenate([[0.0], np.cumsum((h / np.sqrt(square)) @ weight)])
    ends = np.array([[a[0], slope[0], step[0]], [-a[-1], slope[-1], step[-1]]])[:, :, None]
    leaving = ends[:, 0] * 2.0 + ends[:, 1] * u**2  # b over the distance from rest, 1/s²
    if min(float(square.min(initial=1.0)), float(leaving.min())) <= 0.0:
        return None
    durations[inner] = (h / np.sqrt(square)) @ weight
    durations[[0, -1]] = (2.0 * np.sqrt(ends[:, 2] / leaving)) @ weight
    return np.concatenate([[0.0], np.cumsum(durations)])


def _increase_margins(task: Task, margins: LimitMargins, over: LimitExcess) -> LimitMargins:
    """Return the margins, increased by the excess in the intervals next to each knot."""
    K = len(margins.speed)

    def increase(x: Array) -> Array:
        """Return the largest excess (K, …) in the intervals on both sides of each knot, zero where there is none."""
        inside = x[:-1].reshape(K - 1, SAMPLES_PER_INTERVAL, -1).max(axis=1)
        ends = x[::SAMPLES_PER_INTERVAL]
        both = np.maximum(np.vstack([inside, ends[-1:]]), np.vstack([ends[:1], inside]))
        return np.asarray(_MARGIN_FACTOR * np.maximum(both, 0.0))

    speed = margins.speed
    if isinstance(task, HandTask):
        speed = speed + 2.0 * increase(over.speed / task.hand.velocity_limit).max(axis=1)  # b is a squared speed
    limits = acceleration_limits(task)
    limited = limits < np.inf
    acceleration = increase(over.acceleration[:, limited] / limits[limited]).max(axis=1) if limited.any() else 0.0
    slip, normal, torque = (increase(x) for x in (over.slip, over.normal, over.torque))
    forces = (margins.slip + slip, margins.normal + normal, margins.torque + torque)
    return LimitMargins(*forces, speed, margins.acceleration + acceleration)


def _smaller_share(share: Array, excess: Array) -> Array:
    """Return the shares (K − 1,) of the limits of jerk, less the excess there, and everywhere less a small largest one.

    Jerk varies most in the intervals where it changes its sign, and these differ from program to program.
    """
    largest = float(excess.max())
    everywhere = 1.0 + largest if largest < _SMALL_EXCESS else 1.0
    return np.asarray(share / (everywhere * (1.0 + _MARGIN_FACTOR * excess)))


def _check_failure_text(check: PlanCheck) -> str:
    """Return the sentence that states why a plan failed its check."""
    worst = max(LIMIT_WORDS, key=lambda name: getattr(check, name))
    if check.unmet > check.tolerance:
        return f"The contacts cannot supply {100 * check.unmet:.2g} % of the wrench that the motion requires."
    if check.excess > check.tolerance:
        limit = f"the {LIMIT_WORDS[worst]} limit by {100 * check.excess:.2g} %"
        return f"Between its knots the plan exceeds {limit}, even on the finest grid."
    return f"Between its knots a contact is off by {1e3 * check.drift:.2g} mm, even on the finest grid."
