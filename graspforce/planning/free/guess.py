"""First guess of a free move, if the fingers cannot follow the straight path: both ends joined smoothly and slowly."""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array
from graspforce.force.solver import solve
from graspforce.planning.failure import SINGULAR, PlanFailure
from graspforce.planning.free.touching_posture import EndPosture, find_touching_posture
from graspforce.planning.loads import with_torques
from graspforce.planning.path.joint_path import start_posture
from graspforce.planning.path.knots import PathKnots
from graspforce.planning.path.paths import JointPath, StraightPath
from graspforce.planning.path.static_check import find_static_failure
from graspforce.planning.task import GraspTask, IdealTask, ObjectTask
from graspforce.planning.trajectory import Trajectory

_GUESS_SPEED = 0.5  # of the joint speed limits: the guess's largest speed
_MIN_DURATION = 0.05  # s
_MIN_SINGULAR_RATIO = 1e-2  # smallest over largest singular value of a tip Jacobian; a finger below it is singular


def guess_from_end_poses(
    task: ObjectTask, path: StraightPath, q_start: Array | None, intervals: int
) -> Trajectory | PlanFailure:
    """Return a slow motion from start to goal: the object on a straight path, the joints straight between both postures.

    The contacts hold at both ends only; between them the solver must restore them.

    Args:
        task: the task.
        path: the object's straight path.
        q_start: (n,) posture near the start, rad; the neutral posture if None.
        intervals: number of intervals K.

    Returns:
        K + 1 states, or the reason why an end cannot be reached or held still.
    """
    u = np.linspace(0.0, 1.0, intervals + 1)
    s, s_d, s_dd = u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)
    T = _MIN_DURATION
    held: tuple[int, ...] = (0, -1)
    if isinstance(task, IdealTask):
        knots = PathKnots.of_ideal_fingers(task, path, s)
    else:
        ends = _end_postures(task, path, q_start)
        if isinstance(ends, PlanFailure):
            return ends
        first, last = ends
        held = (0, -1) if last.at_contacts else (0,)  # contacts that roll elsewhere depend on the way
        knots = PathKnots.of_grasp(task, path, JointPath.straight(first, last.q), s)
        speed_shares = np.abs(last.q - first) / (_GUESS_SPEED * task.hand.velocity_limit)  # s
        T = max(T, float(speed_shares.max() * s_d.max()))
    failure = find_static_failure(task, knots, held)
    if failure is not None:
        return failure
    f = solve(task.static_problem(knots.poses.p[0], knots.poses.R[0], knots.joints.q[0]), explain=False).f
    return _states(task, knots, f, T, (u, s_d, s_dd))


def _end_postures(task: GraspTask, path: StraightPath, q_start: Array | None) -> tuple[Array, EndPosture] | PlanFailure:
    """Return the posture (n,) at the start, rad, and that at the goal, or the reason why there is none."""
    first = start_posture(task, path, q_start)
    if isinstance(first, PlanFailure):
        return first
    goal = path.points(np.ones(1))
    last = find_touching_posture(task, goal.p[0], goal.R[0], first)
    if isinstance(last, PlanFailure):
        return last
    failure = _singular_finger(task, first, "start", 0.0)
    if failure is None and last.at_contacts:
        failure = _singular_finger(task, last.q, "goal", 1.0)
    return failure or (first, last)


def _states(task: ObjectTask, knots: PathKnots, f: Array, T: float, profile: tuple[Array, Array, Array]) -> Trajectory:
    """Return the states along a path with constant contact forces f (k,), at u T s with ds/du and d²s/du² of ``profile``."""
    u, s_d, s_dd = profile
    rate, acceleration = s_d[:, None] / T, s_dd[:, None] / T**2
    poses, contacts, joints = knots.poses, knots.contacts, knots.joints
    omega = (poses.R @ poses.omega[:, :, None])[:, :, 0]  # the axis is constant: alpha is omega times s̈
    trajectory = Trajectory(
        times=T * u,
        q=joints.q,
        v=joints.q_s * rate,
        a=joints.q_s * acceleration,
        tau=np.zeros((len(u), 0)),
        f=np.tile(f, (len(u), 1)),
        p_HO=poses.p,
        R_HO=poses.R,
        twist=np.hstack([poses.p_s, omega]) * rate,
        acceleration=np.hstack([poses.p_s, omega]) * acceleration,
        p_OC=contacts.p_OC,
        R_OC=contacts.R_OC,
        p_OC_d=contacts.p_OC_s * rate[:, None],
    )
    return with_torques(task, trajectory)


def _singular_finger(task: GraspTask, q: Array, where: str, s: float) -> PlanFailure | None:
    """Return the failure of a finger that is singular at an end, as a stretched one is; None if no finger is.

    Near a singular posture the search finds no move, however slow.
    """
    _, J = task.hand.tips_along(q[None], task.fingers)
    for name, J_finger in zip(task.fingers, J[0], strict=True):
        sigma = np.linalg.svd(J_finger[:, list(task.hand.finger(name).joints)], compute_uv=False)
        if sigma[-1] < _MIN_SINGULAR_RATIO * sigma[0]:
            reason = f"At the {where} finger {name} is singular: it reaches its contact only when almost fully stretched."
            return PlanFailure(SINGULAR, reason, s)
    return None
