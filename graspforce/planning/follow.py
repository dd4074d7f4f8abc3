"""The fingers' joints along an object's path: inverse kinematics, node by node, then a spline through the nodes.

The contacts stay where they are on the object, so the middle of each round tip follows x(s) = p_HO + R_HO (p_OC − r n).
Steps of Newton's method with the pseudo-inverse move the joints least from node to node, which decides what a finger with more
than three joints does with its freedom; a spline of seventh degree then *is* the joints' path, so that q' and q'' are its own
derivatives to rounding. It is held against x(s) between its nodes, and gets more nodes until it follows to `_FOLLOWED`.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from graspforce.arrays import Array
from graspforce.errors import InvalidInput
from graspforce.hand import Hand
from graspforce.planning.path import JointPath, ObjectPath, grid
from graspforce.planning.refusal import SINGULAR, UNREACHABLE, Refusal, beyond_limits
from graspforce.planning.task import Task

_FOLLOWED = 1e-7  # m: a tip this near its place all along the path; a tenth of what inverse kinematics calls reached
_STEPPED = 1e-11  # m: where Newton's steps stop, so that the spline's derivatives are smooth
_STEPS = 12
_NODES = (16, 32, 64, 128, 256)  # intervals between the spline's nodes, tried in turn
_DEGREE = 7
_LOST = 1e-2  # a direction in which the tips move less than this beside their quickest one is lost
_NEEDED = 1e-6  # the part of the path's speed in a lost direction that rounding does not explain
_PLACE = 1e-3  # of s: how exactly a refusal says where
_BEYOND = 1e-6  # rad: a limit exceeded by less is rounding


def follow(task: Task, path: ObjectPath, q_start: Array | None = None) -> JointPath | Refusal:
    """The joints' path that keeps every contact.

    Args:
        task: with a hand and an object.
        path: the object's.
        q_start: (n,) a posture near the first one, rad; by default neutral.

    Returns:
        The joints' path, or why there is none, with the place and the joint.
    """
    hand, contacts = task.hand, task.contacts
    assert hand is not None  # asked only where fingers hold an object
    assert contacts is not None
    first = path.points(np.zeros(1))
    try:
        q = np.array(hand.grasp_posture(task.fingers, contacts, first.p[0], first.R[0], q_start))
    except InvalidInput as error:
        return Refusal(UNREACHABLE, f"At the start, {out_of_reach(task, error)}", 0.0)
    for nodes in _NODES:
        s = grid(nodes)
        tracked = _track(task, path, s, q)
        if isinstance(tracked, Refusal):
            return tracked
        joints = JointPath(make_interp_spline(s, tracked, k=_DEGREE))
        between = np.concatenate([s[:-1] + part * np.diff(s) for part in (0.25, 0.5)])
        p, _ = hand.tips_along(joints.points(between).q, task.fingers)
        if float(np.abs(p - tip_path(task, path, between)[0]).max()) <= _FOLLOWED:
            return joints
    return Refusal(UNREACHABLE, "The path bends too sharply for the fingers to follow it smoothly.")


def tip_path(task: Task, path: ObjectPath, s: Array) -> tuple[Array, Array]:
    """Where the middles of the tips must be at s (K,): (K, N, 3) in H, m, and its derivative."""
    at, centres = path.points(s), task.ball_centres
    turned = np.cross(at.omega[:, None], centres)  # m, in O
    R_OH = at.R.transpose(0, 2, 1)
    return at.p[:, None] + centres @ R_OH, at.p_s[:, None] + turned @ R_OH


def _track(task: Task, path: ObjectPath, s: Array, q_first: Array) -> Array | Refusal:
    """(K, n) the postures at the nodes s."""
    hand = task.hand
    assert hand is not None
    wanted, ways = tip_path(task, path, s)
    used = sorted({joint for name in task.fingers for joint in hand.finger(name).joints})
    tracked = np.tile(q_first, (len(s), 1))
    q_s = np.zeros(len(used))
    for k in range(len(s)):
        q = tracked[k]
        if k:
            q[:] = tracked[k - 1]
            q[used] += q_s * (s[k] - s[k - 1])
        for _ in range(_STEPS):
            p, J = hand.tips_along(q[None], task.fingers)
            missed = (wanted[k] - p[0]).ravel()  # m
            u, sigma, v = np.linalg.svd(J[0].reshape(-1, hand.n)[:, used], full_matrices=False)
            kept = sigma > _LOST * sigma[0]
            if np.abs(missed).max() <= _STEPPED:
                break
            step = v[kept].T @ ((u[:, kept].T @ missed) / sigma[kept])  # rad
            q[used] += step
            if np.abs(step).max() > np.pi:  # never on a path that nodes resolve
                break
        q_s = v[kept].T @ ((u[:, kept].T @ ways[k].ravel()) / sigma[kept])
        refused = _refused(task, float(s[k]), q, missed, ways[k].ravel(), u[:, kept], v[~kept], used)
        if refused is not None:
            return _first(task, path, s[k - 1], s[k], tracked[k - 1], refused) if k else refused
    return tracked


def _first(task: Task, path: ObjectPath, before: float, s: float, q: Array, refused: Refusal) -> Refusal:
    """The refusal at the first place where there is one, to `_PLACE`: the nodes are coarse."""
    if s - before <= _PLACE:
        return refused
    nearer = _track(task, path, np.linspace(before, s, 5), q)
    return nearer if isinstance(nearer, Refusal) else refused


def _refused(
    task: Task, s: float, q: Array, missed: Array, way: Array, movable: Array, lost: Array, used: list[int]
) -> Refusal | None:
    """Why this node ends the search, or None."""
    hand = task.hand
    assert hand is not None
    beyond = np.maximum(hand.q_lower - q, q - hand.q_upper)[used]
    joint = used[int(beyond.argmax())]
    blocked = way - movable @ (movable.T @ way)
    if np.linalg.norm(blocked) > _NEEDED * np.linalg.norm(way):
        i = int(np.linalg.norm(blocked.reshape(-1, 3), axis=1).argmax())
        return _singular(hand, task.fingers[i], s, blocked.reshape(-1, 3)[i], lost, used)
    if np.abs(missed).max() > _FOLLOWED:
        i = int(np.abs(missed.reshape(-1, 3)).max(axis=1).argmax())
        far = 1e3 * float(np.linalg.norm(missed.reshape(-1, 3)[i]))  # mm
        return Refusal(UNREACHABLE, f"At s = {s:.3f} the contact of {task.fingers[i]} is out of its reach, by {far:.2g} mm.", s)
    return beyond_limits(s, hand.joints[joint], float(q[joint])) if beyond.max() > _BEYOND else None


def _singular(hand: Hand, finger: str, s: float, direction: Array, lost: Array, used: list[int]) -> Refusal:
    """A finger cannot move its tip where the path goes: too few joints, or a singular posture."""
    along = ", ".join(f"{x:.2f}" for x in direction / np.linalg.norm(direction))
    own = [used.index(i) for i in hand.finger(finger).joints]
    if len(own) < 3:
        word = f"{len(own)} joint{'s' if len(own) > 1 else ''}"
        joint = hand.joints[used[own[-1]]].name
        reason = f"At s = {s:.3f} finger {finger}, which has {word}, cannot move its tip along ({along}) in H as the path asks."
        return Refusal(SINGULAR, reason, s, joint)
    share = np.abs(lost[:, own]).max(axis=0) if len(lost) else np.ones(len(own))
    joint = hand.joints[used[own[int(share.argmax())]]].name
    reason = (
        f"At s = {s:.3f} finger {finger} is singular: its tip cannot be moved along ({along}) in H as the path asks, "
        f"but by turning joint {joint} beyond measure."
    )
    return Refusal(SINGULAR, reason, s, joint)


def out_of_reach(task: Task, error: InvalidInput) -> str:
    """The words of an error of inverse kinematics, with the finger in place of a field."""
    field = error.field.split("]")[0].removeprefix("contacts[")
    finger = task.fingers[int(field)] if field.isdigit() else "a finger"
    return f"the contact of {finger} must be {error.allowed}."
