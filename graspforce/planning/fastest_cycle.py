"""Minimum-time pick and place: the approach, and the motions of the hand's base with the object in the grasp.

The base of the hand moves along straight lines, p(s) = s d, while posture and object stay at rest in the hand. With the base's
acceleration p̈ = d s̈, the object and the joints need

    G f = w(g − p̈),    tau = tau_u(g − p̈) + Jᵀ f,

which is linear in s̈ and f. This is the program of `graspforce.planning.path.program` with constant G and J: it minimises the
time within friction cones, torque limits, and the limits of the base. The set of accelerations with such forces is convex and
the same at every place. Therefore a profile is checked where its acceleration is least and largest, with the controller's law.

The approach follows its path in the joints with the same program, within torques, rates and jerks of the joints.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from graspforce.contact.motion import BodyMotion
from graspforce.control.joints.joint_trajectory import JointTrajectory
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.control.phases.cycle_plan import CyclePlan
from graspforce.control.phases.load_transfer import inertial_wrench
from graspforce.control.phases.motion_profile import CarryProfiles, MotionProfile
from graspforce.control.settings import ControlSettings
from graspforce.control.state import GraspState
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.records import set_fields
from graspforce.grasp.grasp import Grasp
from graspforce.planning.acceleration_limits import AccelerationLimits
from graspforce.planning.failure import UNHOLDABLE, UNSOLVED, PlanFailure
from graspforce.planning.path import program
from graspforce.planning.path.dynamics import PathDynamics, path_dynamics
from graspforce.planning.path.eased_path import EasedObjectPath, ease, even_knots
from graspforce.planning.path.jerk import PathJerks
from graspforce.planning.path.knots import PathKnots
from graspforce.planning.path.paths import ContactPoints, JointPath, JointPoints, PosePoints, StraightPath
from graspforce.planning.path.plan_along import knot_times, plan_fingers_along
from graspforce.planning.path.program_rows import LimitMargins
from graspforce.planning.path.static_check import find_static_failure
from graspforce.planning.settings import PlanSettings
from graspforce.planning.task import FingerTask, GraspTask
from graspforce.planning.tracking import TORQUE_RESERVE, check_torque_reserve, object_task

_INTERVALS = 60
_SAMPLES = 20  # in each interval, of the check
_STRETCH, _MOST_STRETCHES = 1.1, 30  # of a profile whose forces the controller does not find
_NO_MOTION = 1e-6  # m: a shorter displacement needs no time
_LEAST_TIME = 0.01  # s
_POSTURES = (2, 3, 5, 9, 17, 33)  # of the approach, through which a spline goes
_DEVIATION = 0.02  # rad: largest distance of the approach's postures from the spline


@dataclass(frozen=True, slots=True)
class CycleLimits:
    """Limits of the fastest pick and place, beside those of the hand.

    Args:
        speed: of the base, m/s, > 0.
        acceleration: of the base, m/s², > 0.
        jerk: of the base, m/s³, > 0.
        joint_jerk: of each joint in the approach, rad/s³, > 0.
        torque_reserve: fraction of every motor's torque that is left to feedback, in [0, 1).

    Raises:
        InvalidInput: a value out of range; names the field.
    """

    speed: float = 0.5
    acceleration: float = 3.0
    jerk: float = 60.0
    joint_jerk: float = 2000.0
    torque_reserve: float = TORQUE_RESERVE

    def __post_init__(self) -> None:
        for name in ("speed", "acceleration", "jerk", "joint_jerk"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})
        set_fields(self, torque_reserve=check_torque_reserve(self.torque_reserve))


def fastest_cycle(
    plan: CyclePlan, settings: ControlSettings | None = None, limits: CycleLimits | None = None
) -> CyclePlan | PlanFailure:
    """Return a plan of a cycle with the fastest approach, lift, move and place along the same paths.

    The guarded phases, close, squeeze and release, keep their times: contact ends them.

    Args:
        plan: the plan.
        settings: settings of the object controller, with its reserves and assumed errors; their gravity is that of the plan.
        limits: limits of the motion.

    Returns:
        The plan, or the reason why there is none.
    """
    limits = limits or CycleLimits()
    settings = replace(settings or ControlSettings(), gravity_H=plan.gravity_H)
    approach = fastest_approach(plan, limits)
    if isinstance(approach, PlanFailure):
        return approach
    profiles = []
    for displacement in (plan.lift, plan.move, -plan.lift):
        profile = fastest_profile(plan.grasp, displacement, settings, limits)
        if isinstance(profile, PlanFailure):
            return profile
        profiles.append(profile)
    return replace(plan, approach=approach, profiles=CarryProfiles(*profiles))


def fastest_approach(plan: CyclePlan, limits: CycleLimits) -> JointTrajectory | PlanFailure:
    """Return the fastest motion along the path of a plan's approach, or the reason why there is none.

    Args:
        plan: the plan.
        limits: limits of the motion.
    """
    hand = plan.grasp.hand.derated(1.0 - limits.torque_reserve)
    task = FingerTask(hand, plan.gravity_H, None, AccelerationLimits(joint_jerk=limits.joint_jerk))
    failure = PlanFailure(UNSOLVED, "No smooth path follows the approach.")
    for path in _smooth_paths(plan.approach):
        found = plan_fingers_along(task, path, settings=PlanSettings(_INTERVALS))
        if not isinstance(found, PlanFailure):
            return JointTrajectory(found.knots.times, found.knots.q, found.knots.v, found.knots.a)
        failure = found
    return failure


def _smooth_paths(approach: JointTrajectory) -> Iterator[JointPath]:
    """Return paths near an approach, smoother ones first: splines through some of its postures, evenly spaced along it."""
    q = approach.q
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1)))  # rad
    s = way / way[-1]
    for count in _POSTURES:
        if count > len(q):
            break
        chosen = np.unique([int(np.abs(s - share).argmin()) for share in np.linspace(0.0, 1.0, count)])
        path = JointPath.straight(q[0], q[-1]) if len(chosen) == 2 else JointPath.through(q[chosen])
        dense = path.points(np.linspace(0.0, 1.0, 10 * len(q) + 1)).q
        if float(np.abs(dense[:, None] - q[None]).max(axis=2).min(axis=0).max()) <= _DEVIATION:
            yield path


def fastest_profile(
    grasp: Grasp, displacement: Array, settings: ControlSettings, limits: CycleLimits
) -> MotionProfile | PlanFailure:
    """Return the fastest profile of a straight motion of the base with the object in the grasp, or why there is none.

    Args:
        grasp: the grasp, with the posture and the object's pose in H.
        displacement: (3,) displacement of the base, in H, m.
        settings: settings of the object controller, with gravity.
        limits: limits of the motion.
    """
    if np.linalg.norm(displacement) < _NO_MOTION:
        return MotionProfile.least_jerk(_LEAST_TIME)
    task = object_task(grasp, settings, limits.torque_reserve)
    heavy = replace(task.body, mass=task.body.mass * (1.0 + settings.mass_error))
    bounds = AccelerationLimits(linear=limits.acceleration, linear_jerk=limits.jerk)
    task = replace(task, body=heavy, acceleration_limits=bounds)
    knots = _knots(task, grasp, displacement)
    failure = find_static_failure(task, knots, (0,))
    if failure is not None:
        return failure
    dynamics = _dynamics(task, knots, grasp.q, limits.speed)
    jerks = PathJerks.of_path(task, knots)
    assert jerks is not None  # the task limits jerk
    margins = LimitMargins.slip_only(dynamics, task.slip_margin)
    solution = program.solve_with_jerk(dynamics, margins, jerks, np.ones(len(knots.s) - 1))
    times = None if solution is None else knot_times(knots.s, solution.b, solution.a, rests=False)
    if solution is None or times is None:
        return PlanFailure(UNSOLVED, "The solver found no motion of the base, although a slow one may exist.")
    s, slope, bend = ease(knots.s)
    profile = MotionProfile(times, s, slope * np.sqrt(solution.b), slope * solution.a + bend * solution.b)
    return _with_forces(_within_limits(profile, float(np.linalg.norm(displacement)), limits), grasp, displacement, settings)


def _knots(task: GraspTask, grasp: Grasp, displacement: Array) -> PathKnots:
    """Return the knots of a base that moves with the object: the object's poses in the world, joints and contacts at rest."""
    s = even_knots(_INTERVALS)
    K, n = len(s), grasp.hand.n
    poses = EasedObjectPath(StraightPath(grasp.p_HO, grasp.R_HO, grasp.p_HO + displacement, grasp.R_HO)).points(s)
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, task.contacts, grasp.p_HO, grasp.R_HO)
    still = np.zeros((K, len(task.contacts), 3))
    contacts = ContactPoints(_repeat(task.contacts.p_OC, K), still, _repeat(task.contacts.R_OC, K), _repeat(J, K))
    at_knots, between = (
        JointPoints(_repeat(grasp.q, count), np.zeros((count, n)), np.zeros((count, n))) for count in (K, K - 1)
    )
    return PathKnots(s, poses, contacts, at_knots, between)


def _dynamics(task: GraspTask, knots: PathKnots, q: Array, speed: float) -> PathDynamics:
    """Return the equations of motion, with the base's acceleration in the torques of the links and its speed limit."""
    dynamics, at = path_dynamics(task, knots), knots.poses
    per_acceleration = np.array([task.hand.gravity_torque(q, -axis) for axis in np.eye(3)])  # N·m per m/s²
    middle = _middle(at)
    limit = [np.divide(speed**2, x, out=np.full(len(x), np.inf), where=x > 0.0) for x in ((at.p_s**2).sum(axis=1), middle)]
    return replace(
        dynamics,
        tau_a=at.p_s @ per_acceleration,
        tau_b=at.p_ss @ per_acceleration,
        b_max=limit[0],
        b_max_between=limit[1],
    )


def _middle(at: PosePoints) -> Array:
    """Return the squared slopes ‖p'‖² halfway between the knots, (K − 1,), m²."""
    return np.asarray((((at.p_s[1:] + at.p_s[:-1]) / 2.0) ** 2).sum(axis=1))


def _within_limits(profile: MotionProfile, distance: float, limits: CycleLimits) -> MotionProfile:
    """Return a profile in the least longer time in which speed, acceleration and jerk stay within limits between the knots."""
    u = np.linspace(0.0, 1.0, _SAMPLES, endpoint=False)
    t = np.append((profile.t[:-1, None] + np.diff(profile.t)[:, None] * u).ravel(), profile.duration)
    _, rate, acceleration = profile.sample(t)
    mean_jerk = np.diff(profile.acceleration) / np.diff(profile.t)  # between knots, as the program limits it
    shares = (
        np.abs(rate).max() * distance / limits.speed,
        np.sqrt(np.abs(acceleration).max() * distance / limits.acceleration),
        np.cbrt(np.abs(mean_jerk).max() * distance / limits.jerk),
    )
    return profile.stretched(max(1.0, *(float(share) for share in shares)))


def _with_forces(
    profile: MotionProfile, grasp: Grasp, displacement: Array, settings: ControlSettings
) -> MotionProfile | PlanFailure:
    """Return a profile in a time in which the controller has forces at the least and the largest acceleration."""
    law = ObjectControlLaw(grasp, settings)
    for _ in range(_MOST_STRETCHES):
        extremes = profile.acceleration.min(), profile.acceleration.max()
        if all(_has_forces(law, grasp, float(each) * displacement) for each in extremes):
            return profile
        profile = profile.stretched(_STRETCH)
    return PlanFailure(UNHOLDABLE, "The controller has no forces that accelerate the object with the hand's base.")


def _has_forces(law: ObjectControlLaw, grasp: Grasp, acceleration: Array) -> bool:
    """Return whether the control law has forces at rest in the grasp while the base accelerates."""
    state = GraspState(grasp.q, np.zeros(grasp.hand.n), BodyMotion(grasp.p_HO, grasp.R_HO))
    external = inertial_wrench(grasp.body, grasp.R_HO, acceleration)
    command, _ = law.step(law.initial_memory(), state, BodyMotion(grasp.p_HO, grasp.R_HO), external)
    return not command.forces_reused


def _repeat(x: Array, count: int) -> Array:
    """Return an array with one more axis in front, in which x is repeated."""
    return np.broadcast_to(x, (count, *x.shape))
