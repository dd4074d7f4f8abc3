"""The path of a task at K knots: object, contacts and joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.planning.path.eased_path import EasedJointPath
from graspforce.planning.path.joint_path import contact_points, fixed_contact_points
from graspforce.planning.path.paths import ContactPoints, JointPath, JointPoints, ObjectPath, PosePoints
from graspforce.planning.task import GraspTask, IdealTask


@dataclass(frozen=True, eq=False, slots=True)
class PathKnots:
    """A path at K knots.

    Args:
        s: (K,) path parameters.
        poses: the object at the knots; empty for fingers alone.
        contacts: its contacts at the knots; empty for fingers alone.
        joints: the joints at the knots; without columns for ideal fingers.
        midpoints: the joints halfway between the knots.
    """

    s: Array
    poses: PosePoints
    contacts: ContactPoints
    joints: JointPoints
    midpoints: JointPoints

    @classmethod
    def of_grasp(cls, task: GraspTask, path: ObjectPath, joints: JointPath | EasedJointPath, s: Array) -> PathKnots:
        """Return the knots of a hand that moves an object.

        Args:
            task: the task.
            path: the object's path.
            joints: the joints' path that follows it.
            s: (K,) path parameters.
        """
        poses, at_knots = path.points(s), joints.points(s)
        return cls(s, poses, contact_points(task, poses, at_knots), at_knots, joints.points(_midpoints(s)))

    @classmethod
    def of_ideal_fingers(cls, task: IdealTask, path: ObjectPath, s: Array) -> PathKnots:
        """Return the knots of an object between ideal fingers.

        Args:
            task: the task.
            path: the object's path.
            s: (K,) path parameters.
        """
        return cls(s, path.points(s), fixed_contact_points(task, len(s)), _no_joints(len(s)), _no_joints(len(s) - 1))

    @classmethod
    def of_fingers(cls, path: JointPath | EasedJointPath, s: Array) -> PathKnots:
        """Return the knots of fingers alone.

        Args:
            path: the joints' path.
            s: (K,) path parameters.
        """
        return cls(s, _NO_POSES, _NO_CONTACTS, path.points(s), path.points(_midpoints(s)))


def _midpoints(s: Array) -> Array:
    return np.asarray((s[1:] + s[:-1]) / 2.0)


def _no_joints(count: int) -> JointPoints:
    return JointPoints(*(np.zeros((count, 0)) for _ in range(3)))


_NO_POSES = PosePoints(*(np.zeros((0, *shape)) for shape in ((3,), (3,), (3,), (3, 3), (3,), (3,))))
_NO_CONTACTS = ContactPoints(*(np.zeros(shape) for shape in ((0, 0, 3), (0, 0, 3), (0, 0, 3, 3), (0, 0, 0))))
