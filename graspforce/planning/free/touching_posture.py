"""A posture in which fingertips touch an object that has moved: at their contacts, or at the nearest places within reach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from graspforce.contact.contact import ContactSet
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Shape
from graspforce.planning.failure import UNREACHABLE, PlanFailure
from graspforce.planning.task import GraspTask

_TOUCH_TOLERANCE = 1e-4  # m: largest distance of a fingertip that touches
_PLACE_WEIGHT = 1e-2  # of the distance from the contact: the fingertip is to touch, and near its contact if it can
_STARTS = 10  # postures of a finger from which the search starts before a claim that the object is out of its reach


@dataclass(frozen=True, eq=False, slots=True)
class EndPosture:
    """The posture at the goal of a move.

    Args:
        q: (n,) joint positions, rad.
        at_contacts: whether every fingertip touches at its contact.
    """

    q: Array
    at_contacts: bool


def find_touching_posture(task: GraspTask, p_HO: Array, R_HO: Array, q_start: Array) -> EndPosture | PlanFailure:
    """Return a posture in which every fingertip touches the object.

    If the contact of a rolling tip is out of reach, the tip touches the surface of the object's shape near the contact: after
    rolling it may touch elsewhere at the goal.

    Args:
        task: the task; its fingers share no joints.
        p_HO: (3,) position of the object at the goal, m.
        R_HO: (3, 3) its orientation.
        q_start: (n,) posture to start from, rad.

    Returns:
        The posture, or the failure of a fingertip that touches the object nowhere. A tip that does not roll, or an object
        without a shape, must have the contact within reach.
    """
    q, at_contacts = np.array(q_start), True
    for i, finger in enumerate(task.fingers):
        try:
            q = np.array(task.hand.grasp_posture([finger], ContactSet.stack([task.contacts.contacts[i]]), p_HO, R_HO, q))
        except InvalidInput as error:
            shape = task.body.shape
            if not task.is_rolling[i] or shape is None:  # without a shape, the surface is known at the contacts only
                return PlanFailure(UNREACHABLE, f"At the goal, the contact of {finger} must be {error.allowed}.", 1.0)
            found = _nearest_touch(task, i, shape, (p_HO, R_HO), q)
            if found is None:
                reason = f"At the goal, {finger} reaches no place on the object; its contact must be {error.allowed}."
                return PlanFailure(UNREACHABLE, reason, 1.0)
            q, at_contacts = found, False
    return EndPosture(q, at_contacts)


def _nearest_touch(task: GraspTask, i: int, shape: Shape, pose: tuple[Array, Array], q: Array) -> Array | None:
    """Return a posture (n,) in which finger i touches the surface near its contact; None if it touches it nowhere."""
    hand, (p_HO, R_HO) = task.hand, pose
    joints = list(hand.finger(task.fingers[i]).joints)
    lower, upper = hand.q_lower[joints], hand.q_upper[joints]
    centre = p_HO + R_HO @ (task.contacts.p_OC[i] - task.tip_radii[i] * task.contacts.R_OC[i, :, 2])

    def posture(x: Array) -> Array:
        moved = np.array(q)
        moved[joints] = x
        return moved

    def errors(x: Array) -> Array:
        """Return the weighted displacement of the tip from its contact and its gap to the surface, (4,) m."""
        p_HF = hand.tip_pose(posture(x), task.fingers[i])[0]
        return np.append(_PLACE_WEIGHT * (p_HF - centre), shape.signed_distance((p_HF - p_HO) @ R_HO) - task.tip_radii[i])

    rng = np.random.default_rng(0)
    starts = [np.clip(q[joints], lower, upper), *rng.uniform(lower, upper, (_STARTS - 1, len(joints)))]
    for start in starts:
        found = least_squares(errors, start, bounds=(lower, upper), x_scale=np.maximum(upper - lower, 1e-9), xtol=1e-10)
        if abs(found.fun[-1]) < _TOUCH_TOLERANCE:
            return posture(found.x)
    return None
