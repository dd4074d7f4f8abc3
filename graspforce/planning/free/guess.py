"""Where the search for the fastest move begins: a plan along a straight line, or a slow guess where fingers cannot follow."""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.solver import solve
from graspforce.planning.failure import SINGULAR, UNREACHABLE, PlanFailure
from graspforce.planning.loads import with_torques
from graspforce.planning.path.joint_path import contact_points, reach_error_text, start_posture
from graspforce.planning.path.paths import JointPoints, StraightPath
from graspforce.planning.path.static_check import find_static_failure
from graspforce.planning.plan import Plan, Trajectory
from graspforce.planning.task import Task

_GUESS_SPEED = 0.5  # of the joints' speed limits: how fast the guess is at its fastest
_SHORTEST = 0.05  # s
_STRETCHED = 1e-2  # a finger that moves its tip less than this in one direction beside its quickest is singular


def guess_from_plan(plan: Plan, intervals: int) -> Trajectory:
    """The plan at K + 1 times evenly."""
    return plan.at(plan.duration * np.linspace(0.0, 1.0, intervals + 1))


def guess_from_end_poses(task: Task, path: StraightPath, q_start: Array | None, intervals: int) -> Trajectory | PlanFailure:
    """The object straight from start to goal, the joints straight between the postures of both, smoothly and slowly.

    Contacts are not kept on the way: that is for the solver. Both ends must be reached and held.
    """
    u = np.linspace(0.0, 1.0, intervals + 1)
    s, s_d, s_dd = u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)
    poses = path.points(s)
    ends: list[Array] = []
    if task.hand is not None:
        assert task.contacts is not None  # a held object's
        first = start_posture(task, path, q_start)
        if isinstance(first, PlanFailure):
            return first
        try:
            last = np.array(task.hand.grasp_posture(task.fingers, task.contacts, poses.p[-1], poses.R[-1], first))
        except InvalidInput as error:
            return PlanFailure(UNREACHABLE, f"At the goal, {reach_error_text(task, error)}", 1.0)
        stretched = _singular_finger(task, first, "start", 0.0) or _singular_finger(task, last, "goal", 1.0)
        if stretched is not None:
            return stretched
        ends = [first, last]
    else:
        ends = [np.zeros(0)] * 2
    way = ends[1] - ends[0]
    joints = JointPoints(ends[0] + s[:, None] * way, np.tile(way, (len(s), 1)), np.zeros((len(s), len(way))))
    contacts = contact_points(task, poses, joints)
    failure = find_static_failure(task, s, poses, contacts, joints, (0, -1))
    if failure is not None:
        return failure
    T = _SHORTEST
    if task.hand is not None:
        T = max(T, float((np.abs(way) / (_GUESS_SPEED * task.hand.velocity_limit)).max() * s_d.max()))
    held = solve(task.static_problem(poses.R[0], poses.p[0], ends[0]), explain=False).f
    rate, haste = s_d[:, None] / T, s_dd[:, None] / T**2
    turn = (poses.R @ poses.omega[:, :, None])[:, :, 0]  # about a fixed axis: its rate is s̈ times it
    return with_torques(
        task,
        Trajectory(
            T * u,
            joints.q,
            way * rate,
            way * haste,
            np.zeros((len(s), 0)),
            np.tile(held, (len(s), 1)),
            poses.p,
            poses.R,
            np.hstack([poses.p_s * rate, turn * rate]),
            np.hstack([poses.p_s * haste, turn * haste]),
            contacts.p_OC,
            contacts.R_OC,
            contacts.p_OC_s * rate[:, None],
        ),
    )


def _singular_finger(task: Task, q: Array, where: str, s: float) -> PlanFailure | None:
    """A finger that is singular at an end, as one stretched out is: about there no move is found, however slow."""
    assert task.hand is not None  # asked only where fingers hold an object
    _, J = task.hand.tips_along(q[None], task.fingers)
    for name, slopes in zip(task.fingers, J[0], strict=True):
        sigma = np.linalg.svd(slopes[:, list(task.hand.finger(name).joints)], compute_uv=False)
        if sigma[-1] < _STRETCHED * sigma[0]:
            reason = f"At the {where} finger {name} is singular: it reaches its contact only stretched out, or nearly so."
            return PlanFailure(SINGULAR, reason, s)
    return None
