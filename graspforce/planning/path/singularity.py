"""Failures of fingers that cannot move their tips as a path requires: too few joints, or a singular posture."""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array
from graspforce.planning.failure import SINGULAR, PlanFailure
from graspforce.planning.task import GraspTask


def blocked_failure(task: GraspTask, s: float, R_HC: Array, blocked: Array, lost: dict[int, Array]) -> PlanFailure:
    """Return the failure of the finger whose constraints are violated the most.

    Args:
        task: the task.
        s: path parameter.
        R_HC: (N, 3, 3) contact frames in H.
        blocked: (c,) violations of the rolling constraints, of points and then of spins.
        lost: for each joint of the fingers, its components in the directions that move no tip.
    """
    rows, spins = task.constrained
    count = int(rows.sum())
    slip = np.zeros(len(rows))
    slip[rows] = blocked[:count]
    spin = np.abs(blocked[count:])
    if spin.max(initial=0.0) > np.abs(slip).max():
        return _spin_failure(task, int(spins[spin.argmax()]), s)
    i = int(np.linalg.norm(slip.reshape(-1, 3), axis=1).argmax())
    return _singular_failure(task, i, s, R_HC[i] @ slip.reshape(-1, 3)[i], lost)


def _singular_failure(task: GraspTask, i: int, s: float, direction: Array, lost: dict[int, Array]) -> PlanFailure:
    """Return the failure of finger i, whose tip cannot move along a direction in H."""
    hand, finger = task.hand, task.fingers[i]
    vector = ", ".join(f"{x:.2f}" for x in direction / np.linalg.norm(direction))
    joints = hand.finger(finger).joints
    if len(joints) < 3:
        count = f"{len(joints)} joint{'s' if len(joints) > 1 else ''}"
        reason = f"At s = {s:.3f} finger {finger} has {count} and cannot move its tip along ({vector}) in H."
        return PlanFailure(SINGULAR, reason, s, hand.joints[joints[-1]].name)
    joint = hand.joints[max(joints, key=lambda j: float(np.abs(lost[j]).max()))].name
    reason = (
        f"At s = {s:.3f} finger {finger} is singular: its tip cannot move along ({vector}) in H, "
        f"however fast joint {joint} turns."
    )
    return PlanFailure(SINGULAR, reason, s, joint)


def _spin_failure(task: GraspTask, i: int, s: float) -> PlanFailure:
    """Return the failure of finger i, whose soft tip would spin on the object."""
    hand, finger = task.hand, task.fingers[i]
    joints = hand.finger(finger).joints
    reason = (
        f"At s = {s:.3f} the soft tip of {finger} would spin on the object: "
        f"with {len(joints)} joints it cannot turn with the object about the contact's normal."
    )
    return PlanFailure(SINGULAR, reason, s, hand.joints[joints[-1]].name)
